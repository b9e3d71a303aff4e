"""Specs of problems of one's own."""
