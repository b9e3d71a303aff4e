"""From scans to terrain: reading them, contact regions, graspable spots, free space."""
