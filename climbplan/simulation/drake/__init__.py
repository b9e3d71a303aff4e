"""Exported climbs played in Drake on the robot's own URDF: a second engine as a judge.

Nothing here is shared with planners, checks or the MuJoCo model (an import contract says so). What
is played is what `climbplan export` writes; masses, inertias, joints and collision geometry are the
URDF's as Drake reads them; contact, dynamics and torques are Drake's.
"""
