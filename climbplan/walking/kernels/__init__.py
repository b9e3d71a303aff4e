"""Compiled numerical kernels of walking: dynamics, rollouts, workspace and QP assembly."""
