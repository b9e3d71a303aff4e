"""Pages and figures of what is fitted to data."""
