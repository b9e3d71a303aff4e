"""The online program of X. Lin (UCLA 2022), for comparison."""
