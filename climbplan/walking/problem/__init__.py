"""Walking tasks from specs and from random draws."""
