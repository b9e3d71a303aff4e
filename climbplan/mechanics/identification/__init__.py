"""Stiffness identified from measurements: matrices from tests, joints from matrices."""
