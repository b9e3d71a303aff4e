"""Method `admm`: a mixed-integer and a nonlinear block in consensus (chapter 6.4).

Chapter numbers are those of X. Lin (UCLA 2022).
"""
