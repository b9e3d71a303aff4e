"""A second method for what `zoo` refuses: drawn postures, and statics of all links."""
