"""Footholds and swings of a program: where the other ends of limbs are."""

from __future__ import annotations

import casadi as ca
import numpy as np

from climbplan.limms.building import Building
from climbplan.limms.scene import Array
from climbplan.limms.statement import Phase, Trace

PATCH_MARGIN = 0.035  # [m] of a foot from the edge of the ground it stands on
LIFT = 0.05  # [m] of a foot half-way through its swing


def feet_of(program: Building, phase: Phase, guess: Trace) -> list[list[ca.MX]]:
    """Other ends of all limbs at all knots: anchors, footholds, or feet in the air."""
    store, count = program.store, phase.intervals
    feet: list[list[ca.MX]] = [[] for _ in range(count + 1)]
    for i, limb in enumerate(program.limbs):
        if not limb.is_leg:
            for k in range(count + 1):
                feet[k].append(ca.MX(ca.DM(limb.fixed_position)))
            continue
        before = program.footholds[i]
        if before is None:
            before = _foothold(program, phase.patches[i], guess.feet[0, i])
            program.footholds[i] = before
        if i not in phase.swing:
            for k in range(count + 1):
                feet[k].append(before)
            continue
        after = _foothold(program, phase.patches[i], guess.feet[-1, i])
        program.footholds[i] = after
        path = [before]
        for k in range(1, count):
            path.append(store.variable("foot", guess.feet[k, i], -50.0, 50.0))
            share = k / count
            height = LIFT * 4 * share * (1 - share)
            # Clear of the lower of both grounds early and late, of the straight line between
            store.add(path[k][2] - ca.fmin(before[2], after[2]) - height, 0.0, np.inf)
        path.append(after)
        for k in range(1, count):
            program.cost += 0.5 * ca.sumsqr(path[k + 1] - 2 * path[k] + path[k - 1]) * count
        for k in range(count + 1):
            feet[k].append(path[k])
    return feet


def _foothold(program: Building, patch: int, start: Array) -> ca.MX:
    ground = program.scene.patches[patch]
    margin = PATCH_MARGIN
    flat = program.store.variable("F", start[:2], ground.lower + margin, ground.upper - margin)
    return ca.vertcat(flat, ground.height)
