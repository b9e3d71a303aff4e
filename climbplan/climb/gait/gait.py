"""The fixed gait between postures (chapter 5.1.4): lift a limb, place it, push the body, next limb.

In a round of N limbs the body covers 1/N of its way after each limb is placed. The critical
instants are the 2 N of a round: after each lift and after each push. Where the spec lets the body
leave its straight way (`posture.steps.shift_max`), each push takes it to where the next limb can be
lifted (`balance.py`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.gait.balance import balancing_shifts
from climbplan.climb.gait.instants import joint_angles, standing_at
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import ClimbScene


def poses_between(rounds: Rounds, share: Array) -> tuple[Array, Array]:
    """Body origins and rotations (M, S, 3) when shares (S,) of every round are covered."""
    ways = ((x[:-1, None], np.diff(x, axis=0)[:, None]) for x in (rounds.com, rounds.rpy))
    com, rpy = (begin + share[:, None] * way for begin, way in ways)
    return com, rpy


def plan_instants(scene: ClimbScene, rounds: Rounds) -> Instants:
    """The 2 N M critical instants of a posture sequence with their joint angles.

    Joint angles are those of the planned pose, without sag. Raises ReachFailure naming round,
    limb and missing reach or joint bound.
    """
    gait = np.array(scene.gait)
    n, m = scene.robot.limb_count, rounds.count
    step = np.arange(n)  # position in the gait order
    rank = np.empty(n, np.int64)
    rank[gait] = step  # (N,) when each limb moves

    # Body fraction of its way: k/N when limb k is lifted, (k+1)/N after its push.
    fraction = np.stack([step / n, (step + 1) / n], axis=1).ravel()  # (2N,)
    com, rpy = poses_between(rounds, fraction)

    # A limb stands on its new place from its own push on.
    is_push = np.tile([False, True], n)  # (2N,)
    moving = np.repeat(gait, 2)  # (2N,) limb of each instant
    placed = rank[None, :] < np.repeat(step, 2)[:, None]  # (2N, N)
    placed |= is_push[:, None] & (np.arange(n)[None, :] == moving[:, None])
    lifted = ~is_push[:, None] & (np.arange(n)[None, :] == moving[:, None])

    old, new = rounds.toes[:-1, None], rounds.toes[1:, None]  # (M, 1, N, 3)
    toes = np.where(placed[None, :, :, None], new, old)
    region = np.where(placed[None], rounds.region[1:, None], rounds.region[:-1, None])

    instants = standing_at(
        scene,
        np.repeat(np.arange(1, m + 1), 2 * n),
        com.reshape(-1, 3),
        rpy.reshape(-1, 3),
        toes.reshape(-1, n, 3),
        region.reshape(-1, n),
        np.tile(lifted, (m, 1)),
    )
    if scene.spec.posture.steps.shift_max > 0:
        instants = _over_the_others(scene, instants)
    angles = joint_angles(scene.robot, instants, instants.toes)
    instants = replace(instants, joint_angles=angles)
    _check_placing(scene, instants)
    return instants


def _over_the_others(scene: ClimbScene, instants: Instants) -> Instants:
    """Instants with the body, at lifts, where the limbs that stay hold it; pushes take it there."""
    lift = np.arange(0, instants.count, 2)
    lifts = Instants(**{name: value[lift] for name, value in vars(instants).items()})
    places = _above_places(scene, lifts, instants)
    shift = balancing_shifts(scene, lifts, places=places)
    off = np.zeros_like(instants.com)
    off[lift] = shift
    off[lift[1:] - 1] = shift[1:]
    return replace(instants, com=instants.com + off)


def _above_places(scene: ClimbScene, lifts: Instants, instants: Instants) -> Instants:
    """The lifts of instants with the limbs above the places that they are put on next."""
    push = np.arange(1, instants.count, 2)
    lifted = lifts.lifted[..., None]
    normal = np.where(lifted, instants.normal[push], lifts.normal)
    above = instants.toes[push] + scene.spec.trajectory.lift * normal
    return replace(lifts, normal=normal, toes=np.where(lifted, above, lifts.toes))


def _check_placing(scene: ClimbScene, instants: Instants) -> None:
    """A lifted limb reaches its new place, and the point above it, before the body moves on."""
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    limb = np.argmax(instants.lifted[lift], axis=1)
    place = instants.toes[push, limb]
    above = place + scene.spec.trajectory.lift * instants.normal[push, limb]
    for point, doing in ((place, " and placed"), (above, ", above its new place")):
        toes, normal = instants.toes.copy(), instants.normal.copy()
        toes[lift, limb], normal[lift, limb] = point, instants.normal[push, limb]
        joint_angles(scene.robot, replace(instants, normal=normal), toes, doing)
