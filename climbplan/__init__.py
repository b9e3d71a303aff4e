"""Verified plans for robots that move by making and breaking contact."""

__version__ = "0.1.0"
