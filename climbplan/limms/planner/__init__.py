"""The planner of method `modes`: from a spec to a plan."""
