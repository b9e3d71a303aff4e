"""The instants of a transition: some limbs lift together and are placed, the body goes on."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.gait.instants import instants_at, joint_angles
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.transition.scene import TransitionScene


def plan_instants(
    scene: TransitionScene, rounds: Rounds, moved: BoolArray, first: Array
) -> Instants:
    """The 2 M instants of a transition with their joint angles.

    moved: (M, N) limbs of each round; first: (3,) where the body is at the first lift. The body
    waits while limbs swing. Joint angles are those of the planned pose, without sag. Raises
    ReachFailure naming round, limb and missing reach.
    """
    m, n = moved.shape
    row = np.repeat(np.arange(m), 2) + np.tile([0, 1], m)  # posture of each instant
    lifted = np.zeros((2 * m, n), bool)
    lifted[::2] = moved
    com = rounds.com[row]
    com[0] = first
    instants = instants_at(
        scene,
        np.repeat(np.arange(1, m + 1), 2),
        com,
        rounds.rpy[row],
        rounds.toes[row],
        rounds.region[row],
        lifted,
    )
    placed = instants.toes.copy()
    placed[::2] = rounds.toes[1:]
    joint_angles(scene.robot, instants, placed, " and placed")
    above = placed.copy()
    above[::2] += scene.spec.trajectory.lift * instants.normal[1::2] * moved[..., None]
    joint_angles(scene.robot, instants, above, ", above their new places")
    return instants
