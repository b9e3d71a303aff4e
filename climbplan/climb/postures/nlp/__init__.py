"""Postures with exact rotations by nonlinear programming: method `nlp` of climbs."""
