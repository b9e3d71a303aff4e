"""Simulation of walks in MuJoCo: as one rigid body or with the whole robot."""
