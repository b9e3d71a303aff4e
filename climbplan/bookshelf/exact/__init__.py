"""Minimum movement with proof: geometric branch and bound in the meaning `contact`."""
