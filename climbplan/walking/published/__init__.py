"""The published online program, for comparison."""
