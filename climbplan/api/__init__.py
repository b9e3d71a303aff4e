"""The public door: load, plan, solve, verify and read, for notebooks and for the command line."""
