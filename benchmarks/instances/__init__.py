"""Solvers compared on the public set of contact problems."""
