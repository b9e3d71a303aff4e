"""The checks of a climb plan, computed from its stored arrays alone.

Nothing here shares code with the planner: rotations, kinematics, Jacobians and distances are
built anew from the definitions in the file format, so that a mistake in the planner cannot hide.
"""
