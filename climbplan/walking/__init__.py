"""Hybrid model predictive control of a walking quadruped (chapter 8.2)."""
