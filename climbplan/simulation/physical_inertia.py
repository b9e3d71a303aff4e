"""Inertias that rigid bodies can have, as MuJoCo demands them.

An inertia I about the centre of mass belongs to a body of positive mass density where the second
moments S = trace(I)/2 1 - I are positive semidefinite: no principal moment is above the sum of the
other two (Wensing, Kim and Slotine 2018). Thin plates are at that bound, and files that are rounded
to a few digits are beyond it.
"""

from __future__ import annotations

import logging
from functools import lru_cache

import numpy as np

from climbplan.arrays import Array

_log = logging.getLogger(__name__)

_MARGIN = 1e-6  # least principal second moment, relative to their sum
_LEAST = 1e-12  # [kg m^2] likewise, of points
_ROUNDING = 1e-3  # change relative to the inertia that is worth no warning


def repair_inertia(inertia: Array, name: str) -> Array:
    """Return the nearest inertia that a body of positive density can have.

    Logs a warning, once for each name, where more than the rounding of a file is changed.

    Args:
        inertia: (3, 3) about the centre of mass [kg m^2].
        name: Of the link or body, for the warning.
    """
    symmetric = (inertia + inertia.T) / 2
    second = np.trace(symmetric) / 2 * np.eye(3) - symmetric
    value, vector = np.linalg.eigh(second)
    min_moment = max(_MARGIN * float(np.abs(value).sum()), _LEAST)
    if value[0] >= min_moment:
        return np.asarray(symmetric)
    second = (vector * np.maximum(value, min_moment)) @ vector.T
    repaired = np.trace(second) * np.eye(3) - second
    if np.abs(repaired - symmetric).max() > max(
        _ROUNDING * np.abs(symmetric).max(), 10 * min_moment
    ):
        _warn_once(name)
    return np.asarray(repaired)


@lru_cache(maxsize=1024)
def _warn_once(name: str) -> None:
    _log.warning(
        "%s: no rigid body has the inertia that its robot file states (a principal moment is above "
        "the sum of the others); it is simulated with the nearest one that is possible. Correct "
        "<inertia> of that link",
        name,
    )
