"""Numbers, masses and inertias as MJCF has them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from climbplan.arrays import Array
from climbplan.simulation.physical_inertia import repair_inertia


def format_numbers(values: Iterable[float] | Array) -> str:
    """Return values in their order in memory, to nine digits, with spaces between them."""
    return " ".join(f"{v:.9g}" for v in np.ravel(np.asarray(values, float)))


def write_inertial(mass: float, lever: Array, about: Array, name: str) -> str:
    """Return mass and inertia (3, 3) about the centre at lever (3,), both in the axes of the named
    body.

    An inertia that no body can have is repaired, see `repair_inertia`.
    """
    if mass <= 0:
        return '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
    about = repair_inertia(about, name)
    full = [*np.diag(about), about[0, 1], about[0, 2], about[1, 2]]
    return (
        f'<inertial pos="{format_numbers(lever)}" mass="{mass:.12g}" fullinertia="'
        + " ".join(f"{v:.12g}" for v in full)
        + '"/>'
    )
