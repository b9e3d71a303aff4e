"""Least movement, proved: geometric branch and bound in the meaning `contact`."""
