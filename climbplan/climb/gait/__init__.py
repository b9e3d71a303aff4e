"""The fixed gait between postures, the balance of its lifts, and its critical instants."""
