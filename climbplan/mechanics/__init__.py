"""Mechanics of a robot in contact: limb and whole-body stiffness, equilibrium, friction."""
