"""Checks of a plan of modules, at 1 ms and from its file alone."""
