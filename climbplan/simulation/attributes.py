"""Numbers as attributes of MJCF have them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from climbplan.robots.rotations import Array


def numbers(values: Iterable[float] | Array) -> str:
    """Values in their order in memory, to nine digits, with spaces between them."""
    return " ".join(f"{v:.9g}" for v in np.ravel(np.asarray(values, float)))
