"""Robot, terrain, start and goal as arrays."""
