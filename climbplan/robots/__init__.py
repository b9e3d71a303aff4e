"""Robots: geometry, kinematics, and the data files of the built-in ones."""
