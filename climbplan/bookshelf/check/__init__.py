"""The exact checks of placements, in the meaning `contact` and as published.

Published methods and values are those of X. Lin (UCLA 2022).
"""
