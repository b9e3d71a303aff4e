"""Specs of walks (`kind: mpc`)."""
