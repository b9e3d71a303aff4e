"""From a spec to a walk that passes the exact check."""
