"""Spans of samples in which something holds."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import BoolArray


def spans_of(flags: BoolArray) -> list[tuple[int, int]]:
    """Spans (first, after) of samples in which flags (T,) are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
