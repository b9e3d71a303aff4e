"""Forces of climbing robots with grippers (chapter 3.4).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
