"""A public set of contact problems: families drawn from seeds, files, a reader, a comparison."""
