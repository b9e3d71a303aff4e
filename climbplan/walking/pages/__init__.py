"""Pages and figures of walks."""
