"""Robots from URDF files: what planning needs of them, through Pinocchio."""
