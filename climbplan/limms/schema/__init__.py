"""Specs of modules that deliver a box."""
