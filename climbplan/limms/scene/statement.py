"""What the continuous program of a mode sequence is made of: phases, limbs, and an answer.

A phase is a stretch of time with constant modes and contacts. The box's acceleration is piecewise
linear in it, so that its path is a chain of cubics and its dynamics, eq. (6.5), hold exactly
between the knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class Limb:
    """A module that holds the box: an arm (its other end fixed) or a leg (its other end a foot)."""

    module: int
    side: int  # anchor of the box
    box_end: int  # 0: its first end is on the box, 1: its last
    is_leg: bool
    fixed_position: Array  # (3,) of the other end if it is an arm [m]
    other_rotation: Array  # (3, 3) of the other end, constant for arms and legs
    box_rotation: Array  # (3, 3) of the end on the box, in the box's frame
    branch: tuple[int, int, int]  # of the inverse kinematics at the start


@dataclass(frozen=True)
class Phase:
    """Constant modes: how the box moves, and where it may be."""

    kind: str  # "held", "flight"
    lower: Array  # (D,) least placement of the box [m, rad]
    upper: Array  # (D,)
    intervals: int
    shortest: float  # [s]
    longest: float  # [s]


@dataclass(frozen=True)
class Trace:
    """An answer for one phase at its knots (K + 1); placements as `placement.py` has them."""

    phase: Phase
    duration: float  # [s]
    position: Array  # (K + 1, D) placements of the box [m, rad]
    velocity: Array  # (K + 1, D) [m/s, rad/s]
    acceleration: Array  # (K + 1, D) [m/s^2, rad/s^2]
    angles: Array  # (K + 1, limbs, 6) [rad]
    feet: Array  # (K + 1, limbs, 3) other ends of the limbs, which are fixed [m]
    force: Array  # (K + 1, limbs, 3) at latches [N]


def held_forces(offsets: Array, force_limit: float, moment_limit: float) -> Array:
    """Least-norm sharing (6 n, 4) of a force on the box, and a moment about the vertical.

    offsets: (n, 3) from the centre to the latches [m]; all in the box's frame. Rows: forces of all
    n latches, then their moments; both weighted by what a latch holds. With the forces' moments
    about the centre the latch moments sum to the moment that turns the box (eq. (6.6) with the
    latch moment that it leaves out).
    """
    n = len(offsets)
    balance = np.zeros((6, 6 * n))
    for i, (x, y, z) in enumerate(offsets):
        balance[:3, 3 * i : 3 * i + 3] = np.eye(3)
        balance[3:, 3 * i : 3 * i + 3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        balance[3:, 3 * (n + i) : 3 * (n + i) + 3] = np.eye(3)
    weight = np.repeat([force_limit**2, moment_limit**2], 3 * n)
    wanted = np.eye(6)[:, [0, 1, 2, 5]]
    share = (weight[:, None] * balance.T) @ np.linalg.solve((balance * weight) @ balance.T, wanted)
    return np.asarray(share)
