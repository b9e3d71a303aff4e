"""Closed-loop execution of climbs: contacts are measured before the plan goes on."""
