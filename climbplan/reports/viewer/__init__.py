"""Interactive 3-D view of plans of every kind in the browser."""
