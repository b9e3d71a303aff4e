"""Hybrid model predictive control of a walking robot (chapter 8.2).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
