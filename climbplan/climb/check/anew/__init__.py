"""Independent models of robots, gaits and grips from plan files and specs, without planner code."""
