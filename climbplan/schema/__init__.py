"""Spec models: what a user may write, with units, bounds and meaning."""
