"""Generalised Benders decomposition with cuts that are kept from one problem to the next."""
