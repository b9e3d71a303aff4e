"""Compiled numbers of walking: what a tick and a search over gaits need thousands of times."""
