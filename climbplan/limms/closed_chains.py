"""Closed chains from anchors or feet through limbs to the box, in a program: eqs. (6.1), (6.2)."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from climbplan.limms.answers import Cut
from climbplan.limms.building import Building
from climbplan.limms.scene import SIDE_NORMALS
from climbplan.limms.statement import Phase, Trace

SPEED_SHARE = 0.93  # of the joint speed limit that knots may use; the path between them needs some
RANGE_MARGIN = 0.02  # [rad]
APPROACH_MARGIN = 0.15  # [rad] further
OWN_SIDE = 0.02  # [m] of a foot ahead of its face of the box
TURNING = 0.2  # weight of squared joint speeds against time
SINGULAR = (0.05, 0.12, 0.08)  # [m], [rad], [rad] that poses keep from where branches meet


def close_chains(
    program: Building,
    phase: Phase,
    guess: Trace,
    p: list[ca.MX],
    p_velocity: list[ca.MX],
    feet: list[list[ca.MX]],
    step: ca.MX,
    cuts: Sequence[Cut],
) -> list[list[ca.MX]]:
    """Closed chains at every knot, eqs. (6.1) and (6.2), joint ranges and speeds."""
    store, module, count = program.store, program.scene.module, phase.intervals
    if phase.kind == "flight":
        return [[] for _ in p]
    reach = np.array(module.joint_range) - RANGE_MARGIN
    # Where latches close, a module still has to get there: along the anchor's normal
    latching = reach - (APPROACH_MARGIN if program.last is None else 0.0)
    q = [
        [store.variable("q", guess.angles[k, i], -bound, bound) for i in range(len(program.limbs))]
        for k in range(count + 1)
        for bound in ((latching if k == 0 else reach),)
    ]
    for k in range(count + 1):
        for i, limb in enumerate(program.limbs):
            on_box = p[k] + ca.DM(program.scene.side_offset(0, limb.side))
            first, last = (on_box, feet[k][i]) if limb.box_end == 0 else (feet[k][i], on_box)
            r_first, r_last = limb.other_rotation, limb.box_rotation
            if limb.box_end == 0:
                r_first, r_last = r_last, r_first
            points, rotation, _ = program.chain(q[k][i], ca.DM.zeros(6))
            turned = ca.DM(r_first)
            store.equal(first + turned @ points[:, 7] - last)
            error = ca.DM(r_first.T @ r_last).T @ rotation
            store.equal(
                ca.vertcat(
                    error[2, 1] - error[1, 2],
                    error[0, 2] - error[2, 0],
                    error[1, 0] - error[0, 1],
                )
            )
            _away_from_singular(program, q[k][i], limb.branch)
            if limb.is_leg and i not in phase.swing:
                # Each foot on its own side of the box (chapter 6.3, support polygon)
                ahead = ca.dot(ca.DM(SIDE_NORMALS[limb.side]), feet[k][i] - on_box)
                store.add(ahead, OWN_SIDE, np.inf)
            for cut in cuts:
                if cut.limb == i and cut.knot == k:
                    point = first + turned @ points[:, cut.point]
                    if cut.moves_with_box:
                        point = point - p[k]
                    store.add(ca.dot(ca.DM(cut.normal), point), cut.offset, np.inf)
    limit = SPEED_SHARE * module.max_joint_speed
    if phase.kind == "held":
        _rates(program, p_velocity, q, limit)
    for i in range(len(program.limbs)):
        for k in range(count):
            change = q[k + 1][i] - q[k][i]
            store.add(change - limit * step, -np.inf, 0.0)
            store.add(change + limit * step, 0.0, np.inf)
            program.cost += TURNING * ca.sumsqr(change) / step
        if count >= 2 and phase.kind != "held":
            for k, weights in ((0, (-3, 4, -1)), (count, (1, -4, 3))):
                rows = q[:3] if k == 0 else q[-3:]
                end = sum(w * row[i] for w, row in zip(weights, rows, strict=True))
                store.add(end - 2 * limit * step, -np.inf, 0.0)
                store.add(end + 2 * limit * step, 0.0, np.inf)
    return q


def _away_from_singular(program: Building, q: ca.MX, branch: tuple[int, int, int]) -> None:
    """Keep to one branch of the inverse: wrist off the first axis, elbow and wrist bent."""
    lengths = program.scene.module.link_lengths
    shoulder, elbow, wrist = branch
    upper, fore = lengths[2], lengths[3] + lengths[4]
    reach = upper * ca.sin(q[1]) + fore * ca.sin(q[1] + q[2])
    program.store.add(shoulder * reach, SINGULAR[0], np.inf)
    program.store.add(elbow * q[2], SINGULAR[1], np.inf)
    program.store.add(wrist * q[4], SINGULAR[2], np.inf)


def _rates(program: Building, velocity: list[ca.MX], q: list[list[ca.MX]], limit: float) -> None:
    """Exact joint speeds at the knots of arms: near a straight elbow differences mislead."""
    for k, row in enumerate(q):
        for i, limb in enumerate(program.limbs):
            rate = program.store.variable("rate", np.zeros(6), -limit, limit)
            _, _, moved = program.chain(row[i], rate)
            if limb.box_end == 1:
                wanted = ca.DM(limb.other_rotation.T) @ velocity[k]
            else:
                wanted = -ca.DM(limb.box_rotation.T) @ velocity[k]
            program.store.equal(moved - ca.vertcat(wanted, ca.DM.zeros(3)))
