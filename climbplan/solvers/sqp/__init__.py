"""Local sequential quadratic programming on programs whose integers are given."""
