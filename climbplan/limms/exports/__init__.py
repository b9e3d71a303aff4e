"""Module plans as other programs read them."""
