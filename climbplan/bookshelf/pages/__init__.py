"""Pages and figures of bookshelf plans."""
