"""Reconfigurable modules that deliver a box (chapter 6).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
