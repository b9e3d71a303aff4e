"""Files of plans, datasets, answers and certificates: what they hold, written and read."""
