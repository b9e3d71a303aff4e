"""Method `admm`: a mixed-integer and a nonlinear block in consensus (chapter 6.4)."""
