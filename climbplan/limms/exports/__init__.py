"""Module plans in formats of other programs."""
