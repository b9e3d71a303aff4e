"""`bookshelf`: all methods on the same scenes, and published placements."""
