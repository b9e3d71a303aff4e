"""Robots from URDFs: reading them, and what a URDF cannot say."""
