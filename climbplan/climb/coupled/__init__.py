"""Postures planned together with contact forces (chapter 5.2) for a climb's scene.

Chapter numbers are those of X. Lin (UCLA 2022).
"""
