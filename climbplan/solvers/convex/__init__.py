"""Convex instances by DAQP, Clarabel or OSQP, each re-solved where only coefficients change."""
