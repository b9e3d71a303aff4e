"""Plans as files that robots and other simulators read."""
