"""What climbs and transitions are in memory and in their files."""
