"""Shelf and books as arrays, drawn at random or read from files."""
