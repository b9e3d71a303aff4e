"""Robots from URDFs, with no hand work between file and verified plan."""
