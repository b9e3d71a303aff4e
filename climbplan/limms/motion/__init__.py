"""From a course of events to dense samples of everything that moves."""
