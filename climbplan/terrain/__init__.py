"""Terrain: where toes may stand, what must be kept clear, free space for the body."""
