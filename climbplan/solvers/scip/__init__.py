"""SCIP: convex instances, and whole statements with products."""
