"""What a run tells of itself: how it went, when it fell, and what went wrong first."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.contact import AIR, SLIDES, STICKS
from climbplan.climb.simulation.statics.small_algebra import _dot
from climbplan.climb.simulation.statics.surfaces import TUBE
from climbplan.climb.simulation.statics.tuples import Body, Feet, Ground, Playback, Touch
from climbplan.simulation.measures import FALLEN, TUMBLED

# Columns of the row that a run tells of itself
FELL, FELL_STEP, CAUSE, CAUSE_LIMB, CAUSE_STEP, SLIPS, LOST, FARTHEST, BALANCE, USED, SLID = range(
    11
)
COLUMNS = 11
NOTHING, LOSES, SLIPS_OFF, TOO_WEAK, UNBALANCED = range(5)  # causes
# USED: share of a held toe's friction at most in use; SLID: farthest that one slid [m]
_SLIP = 0.005  # [m]


@compiled
def _record(body: Body, touch: Touch, path: Array) -> None:
    """Leave body, toes and forces in a row of a path."""
    n = len(touch.state)
    for a in range(3):
        path[a] = body.com[a]
        for i in range(n):
            path[3 + 3 * i + a] = touch.place[i, a]
            path[3 + 3 * n + 3 * i + a] = touch.force[i, a]


@compiled
def _is_down(plan: Playback, s: int, body: Body, row: Array) -> bool:
    """Whether a body is so low, or so tilted, that it counts as fallen (`replay.py`)."""
    departure, trace = 0.0, 0.0
    for a in range(3):
        departure += (plan.com[s, a] - body.com[a]) ** 2
        for b in range(3):
            trace += plan.rotation[s, a, b] * body.rotation[a, b]
    row[FARTHEST] = max(row[FARTHEST], np.sqrt(departure))
    return plan.com[s, 2] - body.com[2] > FALLEN or (trace - 1) / 2 < np.cos(TUMBLED)


@compiled
def _fell(s: int, row: Array) -> None:
    row[FELL], row[FELL_STEP] = 1, s
    if row[CAUSE] == NOTHING:
        row[CAUSE], row[CAUSE_STEP] = UNBALANCED, s


@compiled
def _used(limb: int, ground: Ground, touch: Touch) -> float:
    """Share of a toe's friction that is in use, 1 of one that slides or has come off."""
    if touch.state[limb] != STICKS:
        return 1.0
    g, force, normal = touch.solid[limb], touch.force[limb], touch.normal[limb]
    mu = ground.tube_friction[g] if touch.face[limb] == TUBE else ground.friction[g]
    press = _dot(force, normal)
    shear = np.sqrt(max(_dot(force, force) - press * press, 0.0))
    return min(shear / max(mu * press, 1e-9), 1.0)


@compiled
def _look(plan: Playback, s: int, ground: Ground, touch: Touch, feet: Feet, row: Array) -> None:
    """Note the first thing that went wrong since all was well."""
    cause, limb = NOTHING, -1
    slips = 0.0
    for i in range(len(touch.state)):
        if feet.slid[i] > _SLIP and plan.stands[s, i]:
            slips += 1.0
        if not plan.stands[s, i]:
            continue
        row[USED] = max(row[USED], _used(i, ground, touch))
        row[SLID] = max(row[SLID], feet.slid[i])
        if touch.state[i] == AIR:
            row[LOST] = 1
            if cause == NOTHING:
                cause, limb = LOSES, i
        elif touch.state[i] == SLIDES:
            if cause != SLIPS_OFF:
                cause, limb = SLIPS_OFF, i
        elif touch.saturated[i] and cause == NOTHING:
            cause, limb = TOO_WEAK, i
    row[SLIPS] = max(row[SLIPS], slips)
    if cause == NOTHING:
        row[CAUSE], row[CAUSE_LIMB] = NOTHING, -1
    elif row[CAUSE] == NOTHING:
        row[CAUSE], row[CAUSE_LIMB], row[CAUSE_STEP] = cause, limb, s
