"""By how much one thing must change for an instant to become feasible, everything else fixed.

Each amount is the exact optimum of a one-parameter family on the exact cones: friction by bisection
(each step a second-order cone program), torque limits and loads as variables of one such program.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.forces.cones import (
    FEASIBLE,
    ConicAnswer,
    ConicProgram,
    InstantCones,
    friction_ends,
    friction_rows,
)

LARGEST_MU = 5.0  # beyond any dry contact: friction is no remedy there
LARGEST_TORQUE_FACTOR = 100.0
LARGEST_STIFFNESS_FACTOR = 100.0
LEAST_SHARE = 1e-3  # of the present mass: a weightless robot is no remedy
_BY_STIFFNESS = ("kinematics.joint_bounds", "force.inward", "static.stability")
_BISECTIONS = 40
_PRECISION = 1e-6  # relative, of the friction factor


@dataclass(frozen=True)
class LoadDirection:
    """A mass whose weight is part of the load."""

    name: str  # "payload" or "mass"
    now: float  # [kg]
    per_kg: Array  # (6,) load of one kilogram, scaled as in InstantCones


@dataclass(frozen=True)
class Interval:
    """Masses for which an instant is feasible, none above the present one."""

    low: float  # [kg]
    high: float  # [kg]


def friction_shortfall(cones: InstantCones) -> float:
    """Least t with |f_t| <= mu f_n / S_mu + t at every contact and all else as asked.

    In units of the load; infinite if even unlimited friction would not do.
    """
    program = ConicProgram(3 * cones.contacts + 1)
    program.forces(cones, friction=False)
    for i in range(cones.contacts):
        rows = friction_rows(cones, i, program.size)
        rows[0, -1] = -1.0
        program.cone(f"force.friction.{i}", rows, friction_ends(cones, i))
    last = np.zeros((1, program.size))
    last[0, -1] = -1.0
    program.below("shortfall", last, np.zeros(1))
    answer = program.minimise(-last[0])
    return np.inf if answer is None else answer.value


def least_friction_factor(cones: InstantCones, at_least: float = 1.0) -> float | None:
    """Least factor >= at_least on all friction coefficients; None if no sensible friction helps."""
    if friction_shortfall(cones.with_friction(at_least)) <= FEASIBLE:
        return at_least
    if not cones.mu.any():
        return None
    low, high = at_least, LARGEST_MU / float(cones.mu.max())
    if high <= low or friction_shortfall(cones.with_friction(high)) > FEASIBLE:
        return None
    for _ in range(_BISECTIONS):
        if high <= low * (1 + _PRECISION):
            break
        middle = float(np.sqrt(low * high))
        if friction_shortfall(cones.with_friction(middle)) <= FEASIBLE:
            high = middle
        else:
            low = middle
    return high


def least_torque_factor(cones: InstantCones) -> float | None:
    """Least factor on all torque limits; None if torque is not what is missing."""
    program = ConicProgram(3 * cones.contacts + 1)
    program.forces(cones, s_column=program.size - 1)
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    answer = program.minimise(cost)
    if answer is None:
        return None
    factor = answer.value / cones.largest_s
    return factor if factor <= LARGEST_TORQUE_FACTOR else None


def least_stiffness_factor(cones: InstantCones) -> float | None:
    """Least factor on all joint stiffnesses; None if giving way is not what is missing.

    Stiffer joints bend less and lose less of their stiffness to the same forces, in proportion.
    """
    program = ConicProgram(3 * cones.contacts + 1)
    program.forces(cones)
    scaled = []
    for name, cone, A, b in program.blocks:
        rows = A.copy()
        if name.startswith(_BY_STIFFNESS):
            rows[:, -1], b = -b, np.zeros(len(b))
        scaled.append((name, cone, rows, b))
    program.blocks = scaled
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    program.below("least", -cost[None], np.zeros(1))
    answer = program.minimise(cost)
    return answer.value if answer and answer.value <= LARGEST_STIFFNESS_FACTOR else None


def feasible_masses(cones: InstantCones, load: LoadDirection) -> Interval | None:
    """The masses in [0, now] for which the instant is feasible; None if there are none."""
    if not load.per_kg.any() or load.now <= 0:
        return None
    ends = [_extreme_mass(cones, load, sign) for sign in (1.0, -1.0)]
    if ends[0] is None or ends[1] is None:
        return None
    low, high = float(ends[0].x[-1]), float(ends[1].x[-1])
    if high < LEAST_SHARE:
        return None
    return Interval(max(0.0, low) * load.now, high * load.now)


def _extreme_mass(cones: InstantCones, load: LoadDirection, sign: float) -> ConicAnswer | None:
    """Least (sign 1) or largest (sign -1) feasible share of the present mass."""
    program = ConicProgram(3 * cones.contacts + 1)
    program.forces(cones)
    name, cone, A, b = program.blocks[0]
    A[:, -1] = load.now * load.per_kg
    program.blocks[0] = (name, cone, A, b + load.now * load.per_kg)
    last = np.zeros((1, program.size))
    last[0, -1] = 1.0
    program.below("most", last, np.ones(1))
    program.below("least", -last, np.zeros(1))
    return program.minimise(sign * last[0])
