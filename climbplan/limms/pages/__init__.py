"""Pages and figures of modules that deliver a box."""
