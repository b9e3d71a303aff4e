"""Walks replayed in MuJoCo."""
