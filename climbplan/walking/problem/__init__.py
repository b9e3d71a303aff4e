"""From specs and random draws to tasks."""
