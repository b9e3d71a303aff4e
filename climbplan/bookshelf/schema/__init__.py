"""Specs of books on a shelf."""
