"""The nominal world of a plan, and the numbering of its footholds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.simulation.world import World


@dataclass(frozen=True)
class FootholdSchedule:
    """The foothold that each limb stands on or comes from, by sample of the trajectory."""

    index: IntArray  # (T, N)
    swing_phase: Array  # (T, N) fraction of the way to the next, 0 in contact
    count: int  # P, the largest number of footholds of a limb


def number_footholds(contact: BoolArray) -> FootholdSchedule:
    """Number the footholds of limbs by the contacts (T, N) of a trajectory."""
    index = np.zeros(contact.shape, np.int64)
    swing_phase = np.zeros(contact.shape)
    max_count = 1
    for limb in range(contact.shape[1]):
        air = spans_of(~contact[:, limb])
        for k, (first, last) in enumerate(air):
            index[first:last, limb] = k
            index[last:, limb] = k + 1
            swing_phase[first:last, limb] = np.arange(1, last - first + 1) / (last - first)
        max_count = max(max_count, len(air) + 1)
    return FootholdSchedule(index, swing_phase, max_count)


def build_nominal_world(plan: ClimbPlan) -> World:
    """Build the world that the plan assumes: no errors, factors of one."""
    robot, count = plan.robot, len(plan.terrain.surfaces)
    shape = (robot.limb_count, robot.joint_count)
    holds = number_footholds(plan.trajectory.contact).count
    return World(
        mass=1.0,
        com=np.zeros(3),
        stiffness=np.ones(shape),
        gain=1.0,
        friction=np.ones(count),
        surface=np.zeros(count),
        tilt=np.zeros((count, 2)),
        backlash=np.zeros(shape),
        placement=np.zeros((robot.limb_count, holds, 3)),
    )
