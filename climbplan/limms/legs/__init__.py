"""Modules as legs of a quadruped whose body is the box."""
