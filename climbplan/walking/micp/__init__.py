"""The walking problem as a mixed-integer linear program that bounds it."""
