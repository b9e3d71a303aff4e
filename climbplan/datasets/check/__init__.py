"""The checks of a dataset, computed from its file alone."""
