"""Shelf and books in numbers, drawn at random or read from files."""
