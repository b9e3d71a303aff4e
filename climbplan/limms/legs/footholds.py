"""Limits of footholds."""

from __future__ import annotations

PATCH_MARGIN = 0.035  # [m] of a foot from the edge of the ground it stands on
