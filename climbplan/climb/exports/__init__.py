"""Climbs as other programs read them: samples, joint motion, and the regulator's files."""
