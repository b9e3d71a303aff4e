"""Long climbs planned a window of rounds at a time."""
