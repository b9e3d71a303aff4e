"""Envelopes of the products of toe positions and forces (chapter 5.2.2): terrains, fits, files."""
