"""Bounds as they are stated: broadcast to a block's shape, and refused by the block's name."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array


def bounds_of(
    owner: str, lower: ArrayLike, upper: ArrayLike, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    """Return lower and upper bounds as arrays of a shape.

    Args:
        owner: Whose bounds they are, as messages name it.
        lower: Numbers that broadcast to `shape`; -inf for no bound.
        upper: Numbers that broadcast to `shape`; inf for no bound.
        shape: The shape of the expression that is bounded.

    Raises:
        ValueError: If they do not fit, a lower bound is above its upper one, or one is NaN.
    """
    low = broadcast(f"{owner}: lower", np.asarray(lower, float), shape)
    high = broadcast(f"{owner}: upper", np.asarray(upper, float), shape)
    wrong = np.argwhere(~(low <= high))
    if len(wrong):
        index = tuple(int(i) for i in wrong[0])
        place = f" at {list(index)}" if index else ""
        raise ValueError(
            f"{owner}: lower <= upper expected, got lower {low[index]:g} and upper "
            f"{high[index]:g}{place}"
        )
    return low, high


def broadcast(owner: str, values: Any, shape: tuple[int, ...]) -> Any:
    """Return an array broadcast to a shape; raises ValueError with both shapes if it cannot be."""
    try:
        return np.broadcast_to(values, shape)
    except ValueError as error:
        raise ValueError(
            f"{owner}: shape {shape} expected, or one that broadcasts to it, got {values.shape}"
        ) from error
