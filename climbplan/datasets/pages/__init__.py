"""Pages and figures about datasets."""
