"""Walks: in memory, in files, and in words."""
