"""What a walking problem is given, in numbers."""
