"""From a spec to a walk that the exact check judged."""
