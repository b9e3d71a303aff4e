"""The checks of a climb plan, computed from its stored arrays alone.

Nothing here shares code with the planner. Rotations, kinematics, Jacobians and distances are
implemented a second time from the definitions of the file format, so that a mistake in the planner
cannot hide.
"""
