"""A second method for what `bench zoo` refuses: drawn postures, and statics of all links."""
