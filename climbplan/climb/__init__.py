"""Climbing (chapter 5): postures, forces, both together, transitions, grips, and their checks."""
