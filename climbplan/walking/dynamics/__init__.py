"""Cost and rigid-body dynamics of a walk, and where toes are by the integers."""
