"""Climbing (chapter 5): postures, forces, both together, transitions, grips, and their checks.

Chapter numbers are those of X. Lin (UCLA 2022).
"""
