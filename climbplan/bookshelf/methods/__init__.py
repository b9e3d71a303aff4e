"""The methods that solve scenes, by name."""
