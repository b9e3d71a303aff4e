"""Robots proposed from their URDF, tested by planning climbs."""
