"""Envelopes of the products of toe positions and forces (chapter 5.2.2): terrains, fits, files.

Chapter numbers are those of X. Lin (UCLA 2022).
"""
