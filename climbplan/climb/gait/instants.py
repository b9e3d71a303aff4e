"""Critical instants of a motion, from where limbs stand and which are lifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene, compute_load_wrench
from climbplan.robots.kinematics import (
    require_reachable,
    sole_turns,
    solve_inverse_kinematics,
    to_body,
)
from climbplan.robots.model import Robot


def build_instants_at(
    scene: MotionScene,
    rounds: IntArray,
    com: Array,
    rpy: Array,
    toes: Array,
    *,
    region: IntArray,
    lifted: BoolArray,
) -> Instants:
    """Instants with their joint angles, those of the planned pose, without sag.

    Arguments as of `standing_at`. Raises ReachFailure naming round, limb and missing reach or joint
    bound.
    """
    instants = build_instants(scene, rounds, com, rpy, toes, region=region, lifted=lifted)
    return replace(
        instants, joint_angles=compute_joint_angles(scene.robot, instants, instants.toes)
    )


def build_instants(
    scene: MotionScene,
    rounds: IntArray,
    com: Array,
    rpy: Array,
    toes: Array,
    *,
    region: IntArray,
    lifted: BoolArray,
) -> Instants:
    """Instants whose joint angles are not known yet (NaN).

    rounds: (K,) from 1 on; com, rpy: (K, 3); toes: (K, N, 3) where limbs stand, or stood before
    they were lifted, world frame [m]; region, lifted: (K, N).
    """
    normals, mu = np.empty_like(toes), np.empty(region.shape)
    for index, surface in enumerate(scene.terrain.surfaces):
        uses_surface = region == index
        mu[uses_surface] = surface.friction
        normals[uses_surface] = surface.normal_at(toes[uses_surface])
    toes = toes + scene.spec.trajectory.swing_clearance * normals * lifted[..., None]
    return Instants(
        round=rounds,
        lifted=lifted,
        contact=~lifted,
        com=com,
        rpy=rpy,
        toes=toes,
        normal=normals,
        mu=mu,
        region=region,
        joint_angles=np.full((*region.shape, scene.robot.joint_count), np.nan),
        external_wrench=compute_load_wrench(scene.spec, scene.robot, rpy),
    )


def compute_joint_angles(robot: Robot, instants: Instants, toes: Array, doing: str = "") -> Array:
    """Joint angles (K, N, J) for toes (K, N, 3) at the instants' poses.

    Raises ReachFailure with the instant and what is being done there (`doing`).
    """
    toes_body = to_body(instants.com, instants.rpy, toes)
    turns = sole_turns(robot, instants.rpy, instants.normal)
    solution = solve_inverse_kinematics(robot, toes_body, turns)
    names = robot.limb_names
    for k in np.flatnonzero(~solution.valid.all(axis=1)):
        violation = None if turns is None else turns[k]
        require_reachable(robot, toes_body[k], instants.label(int(k), names) + doing, violation)
    return solution.best()
