"""Specs of climbs and transitions."""
