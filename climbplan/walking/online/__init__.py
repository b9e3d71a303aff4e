"""The controller in its loop: what it is told, and what it tries within a tick."""
