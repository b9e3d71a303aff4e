"""Bookshelf runs: in memory, in files, and in words."""
