"""Modules as arms that carry or throw the box."""
