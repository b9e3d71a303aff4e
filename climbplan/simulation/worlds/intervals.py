"""Intervals of probabilities."""

from __future__ import annotations

from scipy.special import betaincinv

CONFIDENCE = 0.95


def clopper_pearson(falls: int, worlds: int) -> tuple[float, float]:
    """Exact 95 % interval of a probability by `falls` among `worlds`."""
    if worlds == 0:
        return 0.0, 1.0
    tail = (1 - CONFIDENCE) / 2
    low = float(betaincinv(falls, worlds - falls + 1, tail)) if falls else 0.0
    high = float(betaincinv(falls + 1, worlds - falls, 1 - tail)) if falls < worlds else 1.0
    return low, high
