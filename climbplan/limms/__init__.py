"""Reconfigurable modules that deliver a box (chapter 6)."""
