"""Robots as users write them."""
