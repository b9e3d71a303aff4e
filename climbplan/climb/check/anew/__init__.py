"""Robots, gaits and grips built anew from plan files and specs, without the planner's code."""
