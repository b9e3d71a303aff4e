"""The exact checks of placements, in the meaning `contact` and as published."""
