"""From a sequence of events to dense samples of everything that moves."""
