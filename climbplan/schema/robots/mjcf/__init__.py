"""Robots from MJCF files: compiled by MuJoCo, written anew as URDF."""
