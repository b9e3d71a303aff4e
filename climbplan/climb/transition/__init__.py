"""Transition: from standing on the ground to bracing between walls (chapter 5.3).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
