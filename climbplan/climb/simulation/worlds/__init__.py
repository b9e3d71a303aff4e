"""Worlds: Monte Carlo samples of uncertain robots and terrain, which differ from the plan's."""
