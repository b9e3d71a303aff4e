"""Simulation of plans of modules in MuJoCo."""
