"""Data of the multi-phase trajectory optimisation of a mode sequence: phases, limbs and solutions.

A phase has constant modes and contacts. The acceleration of the box is piecewise linear in it. So
its path is a chain of cubics, and its dynamics, eq. (6.5), hold exactly between the knots.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class SupportModule:
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
class BoxPhase:
    """A phase of constant modes: how the box moves, and where it may be."""

    kind: str  # "held", "flight"
    lower: Array  # (D,) lower bound of the placement of the box [m, rad]
    upper: Array  # (D,)
    intervals: int
    shortest: float  # [s]
    longest: float  # [s]


@dataclass(frozen=True)
class PhaseTrajectory:
    """The trajectory of one phase at its knots (K + 1); placements as in `placement.py`."""

    phase: BoxPhase
    duration: float  # [s]
    position: Array  # (K + 1, D) placements of the box [m, rad]
    velocity: Array  # (K + 1, D) [m/s, rad/s]
    acceleration: Array  # (K + 1, D) [m/s^2, rad/s^2]
    angles: Array  # (K + 1, limbs, 6) [rad]
    feet: Array  # (K + 1, limbs, 3) other ends of the limbs, which are fixed [m]
    force: Array  # (K + 1, limbs, 3) at latches [N]


def compute_load_sharing(offsets: Array, force_limit: float, moment_limit: float) -> Array:
    """Return the least-norm sharing (6 n, 4) of a force on the box and a moment about the vertical.

    This is the weighted pseudo-inverse of the equilibrium equations. Rows are the forces of all n
    latches, then their moments, both weighted by the capacity of a latch. With the moments of the
    forces about the centre, the latch moments sum to the moment that turns the box. This is eq.
    (6.6) with the latch moment, which that equation neglects.

    Args:
        offsets: Vectors from the centre to the latches (n, 3), in the box frame [m].
        force_limit: Force that a latch holds [N].
        moment_limit: Moment that a latch holds [N m].
    """
    num_latches = len(offsets)
    balance = np.zeros((6, 6 * num_latches))
    for i, (x, y, z) in enumerate(offsets):
        balance[:3, 3 * i : 3 * i + 3] = np.eye(3)
        balance[3:, 3 * i : 3 * i + 3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        balance[3:, 3 * (num_latches + i) : 3 * (num_latches + i) + 3] = np.eye(3)
    weight = np.repeat([force_limit**2, moment_limit**2], 3 * num_latches)
    unit_loads = np.eye(6)[:, [0, 1, 2, 5]]
    sharing = (weight[:, None] * balance.T) @ np.linalg.solve(
        (balance * weight) @ balance.T, unit_loads
    )
    return np.asarray(sharing)
