"""Whole walks: search over gaits, and all knots as one nonlinear program."""
