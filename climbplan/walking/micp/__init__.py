"""Lower bounds on the cost of walks, by spatial branch and bound on a mixed-integer relaxation."""
