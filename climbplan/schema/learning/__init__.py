"""Specs of what is fitted to data."""
