"""Proofs of bounds, and a checker that trusts nothing but the numbers of the problem."""
