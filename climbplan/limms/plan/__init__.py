"""Module plans in memory, in files, and in words."""
