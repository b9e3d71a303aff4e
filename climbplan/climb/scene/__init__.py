"""Robot, terrain, start and goal in numbers."""
