"""From a spec to a plan: method `modes`."""
