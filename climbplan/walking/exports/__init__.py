"""Walks as other programs read them."""
