"""Simulation of climbs and transitions in MuJoCo and by implicit steps, in uncertain worlds too."""
