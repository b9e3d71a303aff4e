"""Rows of motions: robots and scenes drawn, planned, verified, simulated and exported."""
