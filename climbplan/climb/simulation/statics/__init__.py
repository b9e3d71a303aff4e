"""Quasi-static runs of braced robots: many worlds a second, from the plan's arrays alone."""
