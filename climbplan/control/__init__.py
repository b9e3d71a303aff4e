"""What runs on a robot beside its motors: NumPy alone, nothing else of this package."""
