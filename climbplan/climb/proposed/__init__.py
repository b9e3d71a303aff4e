"""Robots proposed from their URDF, put to the test of climbs."""
