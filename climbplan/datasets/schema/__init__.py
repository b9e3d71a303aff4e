"""Specs of datasets."""
