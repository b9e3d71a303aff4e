"""Placements of books as other programs read them."""
