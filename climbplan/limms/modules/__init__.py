"""A single module: kinematics, contact distances, and masses."""
