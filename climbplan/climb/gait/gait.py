"""The fixed gait between postures (chapter 5.1.4): lift a limb, place it, push the body, next limb.

In a round of N limbs the body covers 1/N of its path after each limb is placed. A round has 2 N
critical instants: after each lift and after each push. If the spec allows the body to leave its
straight path (`posture.steps.com_shift_max`), each push moves it to where the next limb can be
lifted (`balance.py`).

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.gait.balance import find_balancing_shifts
from climbplan.climb.gait.instants import build_instants, compute_joint_angles
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene


def interpolate_poses(rounds: Rounds, fractions: Array) -> tuple[Array, Array]:
    """Interpolate body origins and rotations (M, S, 3) at fractions (S,) of every round."""
    segments = ((x[:-1, None], np.diff(x, axis=0)[:, None]) for x in (rounds.com, rounds.rpy))
    com, rpy = (start + fractions[:, None] * segment for start, segment in segments)
    return com, rpy


def plan_instants(scene: ClimbScene, rounds: Rounds) -> Instants:
    """Build the 2 N M critical instants of a posture sequence with joint angles, without sag.

    Raises:
        ReachFailure: A toe is out of reach; it names round, limb and missing reach or joint bound.
    """
    gait = np.array(scene.gait)
    n, m = scene.robot.limb_count, rounds.count
    step = np.arange(n)  # position in the gait order
    rank = np.empty(n, np.int64)
    rank[gait] = step  # (N,) when each limb moves

    # Body fraction of its way: k/N when limb k is lifted, (k+1)/N after its push.
    fraction = np.stack([step / n, (step + 1) / n], axis=1).ravel()  # (2N,)
    com, rpy = interpolate_poses(rounds, fraction)

    # A limb stands on its new place from its own push on.
    is_push = np.tile([False, True], n)  # (2N,)
    moving = np.repeat(gait, 2)  # (2N,) limb of each instant
    placed = rank[None, :] < np.repeat(step, 2)[:, None]  # (2N, N)
    placed |= is_push[:, None] & (np.arange(n)[None, :] == moving[:, None])
    lifted = ~is_push[:, None] & (np.arange(n)[None, :] == moving[:, None])

    old, new = rounds.toes[:-1, None], rounds.toes[1:, None]  # (M, 1, N, 3)
    toes = np.where(placed[None, :, :, None], new, old)
    region = np.where(placed[None], rounds.region[1:, None], rounds.region[:-1, None])

    instants = build_instants(
        scene,
        np.repeat(np.arange(1, m + 1), 2 * n),
        com.reshape(-1, 3),
        rpy.reshape(-1, 3),
        toes.reshape(-1, n, 3),
        region=region.reshape(-1, n),
        lifted=np.tile(lifted, (m, 1)),
    )
    if scene.spec.posture.steps.com_shift_max > 0:
        instants = _shift_over_support(scene, instants)
    angles = compute_joint_angles(scene.robot, instants, instants.toes)
    instants = replace(instants, joint_angles=angles)
    _check_placing(scene, instants)
    return instants


def _shift_over_support(scene: ClimbScene, instants: Instants) -> Instants:
    """Shift the body of lifts over the standing limbs; the pushes before move it there."""
    lift = np.arange(0, instants.count, 2)
    lifts = Instants(**{name: value[lift] for name, value in vars(instants).items()})
    places = _hover_over_places(scene, lifts, instants)
    shift = find_balancing_shifts(scene, lifts, places=places)
    offset = np.zeros_like(instants.com)
    offset[lift] = shift
    offset[lift[1:] - 1] = shift[1:]
    return replace(instants, com=instants.com + offset)


def _hover_over_places(scene: ClimbScene, lifts: Instants, instants: Instants) -> Instants:
    """Return the lifts with the lifted limbs above their next places."""
    push = np.arange(1, instants.count, 2)
    lifted = lifts.lifted[..., None]
    normal = np.where(lifted, instants.normal[push], lifts.normal)
    above = instants.toes[push] + scene.spec.trajectory.swing_clearance * normal
    return replace(lifts, normal=normal, toes=np.where(lifted, above, lifts.toes))


def _check_placing(scene: ClimbScene, instants: Instants) -> None:
    """A lifted limb reaches its new place, and the point above it, before the body moves on."""
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    limb = np.argmax(instants.lifted[lift], axis=1)
    place = instants.toes[push, limb]
    above = place + scene.spec.trajectory.swing_clearance * instants.normal[push, limb]
    for point, doing in ((place, " and placed"), (above, ", above its new place")):
        toes, normal = instants.toes.copy(), instants.normal.copy()
        toes[lift, limb], normal[lift, limb] = point, instants.normal[push, limb]
        compute_joint_angles(scene.robot, replace(instants, normal=normal), toes, doing)
