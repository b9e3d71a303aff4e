"""Strategies learned from solved problems: which integers to try first."""
