"""Hybrid model predictive control of a walking robot (chapter 8.2)."""
