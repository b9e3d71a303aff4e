"""Pages and figures of datasets, and of what is fitted to data."""
