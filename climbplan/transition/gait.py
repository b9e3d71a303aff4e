"""The instants of a transition: some limbs lift together and are placed, the body goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.climb.scene import load_wrench
from climbplan.plans.climb_plan import Array, Instants, Mask, Rounds
from climbplan.robots.kinematics import inverse, require_reachable, to_body
from climbplan.transition.scene import TransitionScene


def plan_instants(scene: TransitionScene, rounds: Rounds, moved: Mask) -> Instants:
    """The 2 M instants of a transition with their joint angles.

    moved: (M, N) limbs of each round. The body waits while limbs swing. Joint angles are those of
    the planned pose, without sag. Raises ReachFailure naming round, limb and missing reach.
    """
    robot, terrain = scene.robot, scene.terrain
    m, n = moved.shape
    row = np.repeat(np.arange(m), 2) + np.tile([0, 1], m)  # posture of each instant
    lifted = np.zeros((2 * m, n), bool)
    lifted[::2] = moved
    region = rounds.region[row]
    toes = rounds.toes[row]
    normal, mu = np.empty_like(toes), np.empty(region.shape)
    for index, surface in enumerate(terrain.surfaces):
        here = region == index
        mu[here] = surface.friction
        normal[here] = surface.normal_at(toes[here])
    lift = scene.spec.trajectory.lift
    toes = toes + lift * normal * lifted[..., None]
    com, rpy = rounds.com[row], rounds.rpy[row]
    instants = Instants(
        round=np.repeat(np.arange(1, m + 1), 2),
        lifted=lifted,
        contact=~lifted,
        com=com,
        rpy=rpy,
        toes=toes,
        normal=normal,
        mu=mu,
        region=region,
        joint_angles=np.zeros((2 * m, n, 3)),
        external_wrench=load_wrench(scene.spec, robot, rpy),
    )
    angles = _joint_angles(scene, instants, toes, "")
    placed = toes.copy()
    placed[::2] = rounds.toes[1:]
    _joint_angles(scene, instants, placed, " and placed")
    above = placed.copy()
    above[::2] += lift * normal[1::2] * moved[..., None]
    _joint_angles(scene, instants, above, ", above their new places")
    return replace(instants, joint_angles=angles)


def _joint_angles(scene: TransitionScene, instants: Instants, toes: Array, doing: str) -> Array:
    """Joint angles (K, N, 3) for toes (K, N, 3); raises ReachFailure."""
    toes_body = to_body(instants.com, instants.rpy, toes)
    solution = inverse(scene.robot, toes_body)
    names = scene.robot.limb_names
    for k in np.flatnonzero(~solution.valid.all(axis=1)):
        require_reachable(scene.robot, toes_body[k], instants.label(int(k), names) + doing)
    return solution.best()
