"""Postures planned together with contact forces (chapter 5.2) for a climb's scene."""
