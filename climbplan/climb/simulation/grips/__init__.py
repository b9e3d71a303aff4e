"""Grippers in a simulated run."""
