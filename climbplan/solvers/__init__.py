"""Solvers: one file a backend, and our own branch and bound over disjunctions."""
