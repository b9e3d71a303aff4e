"""Cost and rigid-body dynamics of a walk."""
