"""Online walking: hybrid model-predictive control, state estimation and closed-loop simulation."""
