"""Worlds that are not what the plan believes: what is uncertain, and draws of it."""
