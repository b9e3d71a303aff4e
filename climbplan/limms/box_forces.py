"""Forces on the box in a program: dynamics, eq. (6.5), and what holds or pushes it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from climbplan.limms.building import Building
from climbplan.limms.scene import GRAVITY
from climbplan.limms.statement import Phase, Trace, held_forces

FORCE_SHARE = 0.985  # of the limits that knots may use
CONE_SHARE = 0.96
LEAST_FORCE = 0.05  # [N] on a foot that stands


def box_forces(
    program: Building,
    phase: Phase,
    guess: Trace,
    p: list[ca.MX],
    a: list[ca.MX],
    feet: list[list[ca.MX]],
) -> list[list[ca.MX]]:
    """Dynamics, eq. (6.5), with limits of latches, or friction and moment balance of feet."""
    store, scene = program.store, program.scene
    mass, most = float(scene.box_mass[0]), FORCE_SHARE * scene.module.max_force
    up = ca.DM([0, 0, GRAVITY])
    if phase.kind == "flight":
        for k in range(len(a)):
            store.equal(a[k] + up)
        return [[] for _ in a]
    rows: list[list[ca.MX]] = []
    if phase.kind == "held":
        offsets = np.array([scene.side_offset(0, limb.side) for limb in program.limbs])
        n = len(offsets)
        share = held_forces(offsets, scene.module.max_force, scene.module.latch_moment)
        for k in range(len(a)):
            both = ca.DM(share) @ (mass * (a[k] + up))
            rows.append([both[3 * i : 3 * i + 3] for i in range(n)])
            for i in range(n):
                moment = both[3 * (n + i) : 3 * (n + i) + 3]
                store.add(ca.sumsqr(rows[k][i]) / most**2, 0.0, 1.0)
                limit = FORCE_SHARE * scene.module.latch_moment
                store.add(ca.sumsqr(moment) / limit**2, 0.0, 1.0)
        return rows
    friction = CONE_SHARE * scene.friction
    for k in range(len(a)):
        row = []
        total, moment = ca.MX.zeros(3), ca.MX.zeros(3)
        for i in range(len(program.limbs)):
            if i in phase.swing:
                row.append(ca.MX.zeros(3))
                continue
            start = guess.force[k, i]
            low = np.array([-1.0, -1.0, LEAST_FORCE / most])
            unit = store.variable("f", start / most, low, 1.0)
            f = most * unit
            store.add(ca.sumsqr(unit), 0.0, 1.0)
            # Friction cone of a foot on the ground, eq. (6.8)
            cone = (friction * unit[2]) ** 2 - unit[0] ** 2 - unit[1] ** 2
            store.add(cone, 0.0, np.inf)
            total += f
            moment += ca.cross(feet[k][i] - p[k], f)
            program.cost += 0.01 * ca.sumsqr(unit)
            row.append(f)
        store.equal((mass * (a[k] + up) - total) / 10.0)
        if len(phase.swing) < len(program.limbs):
            store.equal(moment / 10.0)  # eq. (6.6)
        rows.append(row)
    return rows
