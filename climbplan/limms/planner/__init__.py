"""The planner of method `mode-search`: from a spec to a plan."""
