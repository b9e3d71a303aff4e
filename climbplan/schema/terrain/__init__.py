"""Terrain as specs state it: walls and steps, solids, panels of holds, scans."""
