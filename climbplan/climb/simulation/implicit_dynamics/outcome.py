"""The outcome of a simulated motion: whether and when the robot fell, and what failed first."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.contact import AIR, SLIDES, STICKS
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _dot
from climbplan.climb.simulation.implicit_dynamics.state import (
    BodyState,
    ContactSolution,
    FootSlip,
    PlannedMotion,
    TerrainGeometry,
)
from climbplan.climb.simulation.implicit_dynamics.surfaces import TUBE
from climbplan.simulation.measures import FALLEN, TUMBLED

# Columns of an outcome
(
    HAS_FALLEN,
    FALL_STEP,
    CAUSE,
    CAUSE_LIMB,
    CAUSE_STEP,
    MAX_SIMULTANEOUS_SLIPS,
    LOST_CONTACT,
    MAX_DEVIATION,
    LOST_BALANCE,
    FRICTION_USE,
    MAX_SLIP,
) = range(11)
COLUMNS = 11
NO_CAUSE, CONTACT_LOST, TOE_SLIDES, TORQUE_LIMIT, NO_EQUILIBRIUM = range(5)  # causes
# FRICTION_USE: largest fraction of friction used by a pressing toe; MAX_SLIP: longest slip [m]
_SLIP_THRESHOLD = 0.005  # [m]


@compiled
def _record_sample(body: BodyState, solution: ContactSolution, path: Array) -> None:
    """Write body position, toes and forces on them to a row (3 + 6 N,) of a path."""
    n = len(solution.mode)
    for a in range(3):
        path[a] = body.com[a]
        for i in range(n):
            path[3 + 3 * i + a] = solution.position[i, a]
            path[3 + 3 * n + 3 * i + a] = solution.force[i, a]


@compiled
def _has_fallen(motion: PlannedMotion, s: int, body: BodyState, row: Array) -> bool:
    """Return whether a body is too low or too tilted, and update the outcome's deviation."""
    squared_deviation, trace = 0.0, 0.0
    for a in range(3):
        squared_deviation += (motion.com[s, a] - body.com[a]) ** 2
        for b in range(3):
            trace += motion.rotation[s, a, b] * body.rotation[a, b]
    row[MAX_DEVIATION] = max(row[MAX_DEVIATION], np.sqrt(squared_deviation))
    return motion.com[s, 2] - body.com[2] > FALLEN or (trace - 1) / 2 < np.cos(TUMBLED)


@compiled
def _record_fall(s: int, row: Array) -> None:
    """Record a fall in planned step s, without an earlier cause as a lost equilibrium."""
    row[HAS_FALLEN], row[FALL_STEP] = 1, s
    if row[CAUSE] == NO_CAUSE:
        row[CAUSE], row[CAUSE_STEP] = NO_EQUILIBRIUM, s


@compiled
def _compute_friction_utilisation(
    limb: int, ground: TerrainGeometry, solution: ContactSolution
) -> float:
    """Return the fraction of a toe's friction in use, 1 if it slides or has separated."""
    if solution.mode[limb] != STICKS:
        return 1.0
    g, force, normal = solution.solid[limb], solution.force[limb], solution.normal[limb]
    mu = ground.tube_friction[g] if solution.face[limb] == TUBE else ground.friction[g]
    pressure = _dot(force, normal)
    shear = np.sqrt(max(_dot(force, force) - pressure * pressure, 0.0))
    return min(shear / max(mu * pressure, 1e-9), 1.0)


@compiled
def _update_outcome(
    motion: PlannedMotion,
    s: int,
    ground: TerrainGeometry,
    solution: ContactSolution,
    slip: FootSlip,
    row: Array,
) -> None:
    """Update maxima, slips and the first failure since no toe and no motor failed."""
    cause, limb = NO_CAUSE, -1
    num_slips = 0.0
    for i in range(len(solution.mode)):
        if slip.distance[i] > _SLIP_THRESHOLD and motion.should_press[s, i]:
            num_slips += 1.0
        if not motion.should_press[s, i]:
            continue
        row[FRICTION_USE] = max(
            row[FRICTION_USE], _compute_friction_utilisation(i, ground, solution)
        )
        row[MAX_SLIP] = max(row[MAX_SLIP], slip.distance[i])
        if solution.mode[i] == AIR:
            row[LOST_CONTACT] = 1
            if cause == NO_CAUSE:
                cause, limb = CONTACT_LOST, i
        elif solution.mode[i] == SLIDES:
            if cause != TOE_SLIDES:
                cause, limb = TOE_SLIDES, i
        elif solution.saturated[i] and cause == NO_CAUSE:
            cause, limb = TORQUE_LIMIT, i
    row[MAX_SIMULTANEOUS_SLIPS] = max(row[MAX_SIMULTANEOUS_SLIPS], num_slips)
    if cause == NO_CAUSE:
        row[CAUSE], row[CAUSE_LIMB] = NO_CAUSE, -1
    elif row[CAUSE] == NO_CAUSE:
        row[CAUSE], row[CAUSE_LIMB], row[CAUSE_STEP] = cause, limb, s
