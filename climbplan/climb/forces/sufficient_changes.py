"""By how much one quantity must change for an instant to become feasible, all else fixed.

Each amount is the exact optimum of a one-parameter family on the exact cones. Friction is found by
bisection, with a second-order cone program per step. Torque limits, stiffness and loads are
variables of one such program.
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
    build_friction_offsets,
    build_friction_rows,
)

MAX_MU = 5.0  # beyond any dry contact: friction is no remedy there
MAX_TORQUE_FACTOR = 100.0
MAX_STIFFNESS_FACTOR = 100.0
MIN_MASS_FRACTION = 1e-3  # of the present mass: a weightless robot is no remedy
_STIFFNESS_BLOCKS = ("kinematics.joint_bounds", "force.penetration", "static.stability")
_MAX_BISECTIONS = 40
_PRECISION = 1e-6  # relative, of the friction factor


@dataclass(frozen=True)
class LoadDirection:
    """A mass whose weight is part of the load."""

    name: str  # "payload" or "mass"
    current_mass: float  # [kg]
    per_kg: Array  # (6,) load of one kilogram, scaled as in InstantCones


@dataclass(frozen=True)
class Interval:
    """Masses for which an instant is feasible, none above the present one."""

    min_mass: float  # [kg]
    max_mass: float  # [kg]


def compute_friction_shortfall(cones: InstantCones) -> float:
    """Return the smallest t with |f_t| <= mu f_n / S_mu + t at every contact and all else feasible.

    The result is in units of the load; infinite if even unlimited friction would not suffice.
    """
    program = ConicProgram(3 * cones.num_contacts + 1)
    program.add_force_constraints(cones, friction=False)
    for i in range(cones.num_contacts):
        rows = build_friction_rows(cones, i, program.size)
        rows[0, -1] = -1.0
        program.add_second_order_cone(f"force.friction.{i}", rows, build_friction_offsets(cones, i))
    shortfall_row = np.zeros((1, program.size))
    shortfall_row[0, -1] = -1.0
    program.add_inequality("shortfall", shortfall_row, np.zeros(1))
    solution = program.minimise(-shortfall_row[0])
    return np.inf if solution is None else solution.value


def find_min_friction_factor(cones: InstantCones, min_factor: float = 1.0) -> float | None:
    """Return the smallest sufficient factor on all friction coefficients, by bisection.

    Args:
        cones: The instant.
        min_factor: Lower bound of the factor.

    Returns:
        The factor; None if no dry friction is sufficient.
    """
    if compute_friction_shortfall(cones.with_friction(min_factor)) <= FEASIBLE:
        return min_factor
    if not cones.mu.any():
        return None
    low, high = min_factor, MAX_MU / float(cones.mu.max())
    if high <= low or compute_friction_shortfall(cones.with_friction(high)) > FEASIBLE:
        return None
    for _ in range(_MAX_BISECTIONS):
        if high <= low * (1 + _PRECISION):
            break
        middle = float(np.sqrt(low * high))
        if compute_friction_shortfall(cones.with_friction(middle)) <= FEASIBLE:
            high = middle
        else:
            low = middle
    return high


def minimise_torque_factor(cones: InstantCones) -> float | None:
    """Return the smallest sufficient factor on all torque limits; None if torque is not what is
    missing.
    """
    program = ConicProgram(3 * cones.num_contacts + 1)
    program.add_force_constraints(cones, s_column=program.size - 1)
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    solution = program.minimise(cost)
    if solution is None:
        return None
    factor = solution.value / cones.max_s
    return factor if factor <= MAX_TORQUE_FACTOR else None


def minimise_stiffness_factor(cones: InstantCones) -> float | None:
    """Return the smallest sufficient factor on all joint stiffnesses; None if none is sufficient.

    Under the same forces, stiffer joints deflect less and lose less of their stiffness, in
    proportion.
    """
    program = ConicProgram(3 * cones.num_contacts + 1)
    program.add_force_constraints(cones)
    scaled = []
    for name, cone, A, b in program.blocks:
        rows = A.copy()
        if name.startswith(_STIFFNESS_BLOCKS):
            rows[:, -1], b = -b, np.zeros(len(b))
        scaled.append((name, cone, rows, b))
    program.blocks = scaled
    cost = np.zeros(program.size)
    cost[-1] = 1.0
    program.add_inequality("least", -cost[None], np.zeros(1))
    solution = program.minimise(cost)
    return solution.value if solution and solution.value <= MAX_STIFFNESS_FACTOR else None


def find_feasible_masses(cones: InstantCones, load: LoadDirection) -> Interval | None:
    """Return the masses up to the present one with which the instant is feasible, or None."""
    if not load.per_kg.any() or load.current_mass <= 0:
        return None
    extremes = [_optimise_mass(cones, load, sign) for sign in (1.0, -1.0)]
    if extremes[0] is None or extremes[1] is None:
        return None
    low, high = float(extremes[0].x[-1]), float(extremes[1].x[-1])
    if high < MIN_MASS_FRACTION:
        return None
    return Interval(max(0.0, low) * load.current_mass, high * load.current_mass)


def _optimise_mass(cones: InstantCones, load: LoadDirection, sign: float) -> ConicAnswer | None:
    """Return the smallest (sign 1) or largest (sign -1) feasible fraction of the present mass."""
    program = ConicProgram(3 * cones.num_contacts + 1)
    program.add_force_constraints(cones)
    name, cone, A, b = program.blocks[0]
    A[:, -1] = load.current_mass * load.per_kg
    program.blocks[0] = (name, cone, A, b + load.current_mass * load.per_kg)
    mass_row = np.zeros((1, program.size))
    mass_row[0, -1] = 1.0
    program.add_inequality("most", mass_row, np.ones(1))
    program.add_inequality("least", -mass_row, np.zeros(1))
    return program.minimise(sign * mass_row[0])
