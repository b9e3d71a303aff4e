"""Comparison of mixed-integer engines on published problems."""
