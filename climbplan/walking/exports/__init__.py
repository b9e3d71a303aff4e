"""Exports of walks to other programs."""
