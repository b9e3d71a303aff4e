"""Footholds of a plan, and the world that it believes in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.simulation.world import World


@dataclass(frozen=True)
class Footholds:
    """Which foothold each limb stands on or comes from, by sample of the trajectory."""

    number: IntArray  # (T, N)
    share: Array  # (T, N) of the way to the next, 0 while it stands
    count: int  # P, of the limb that has most


def footholds_of(contact: BoolArray) -> Footholds:
    """Footholds by contacts (T, N) of a trajectory."""
    number = np.zeros(contact.shape, np.int64)
    share = np.zeros(contact.shape)
    most = 1
    for limb in range(contact.shape[1]):
        air = spans_of(~contact[:, limb])
        for k, (first, last) in enumerate(air):
            number[first:last, limb] = k
            number[last:, limb] = k + 1
            share[first:last, limb] = np.arange(1, last - first + 1) / (last - first)
        most = max(most, len(air) + 1)
    return Footholds(number, share, most)


def nominal_world(plan: ClimbPlan) -> World:
    """The world that the plan believes in."""
    robot, count = plan.robot, len(plan.terrain.surfaces)
    shape = (robot.limb_count, robot.joint_count)
    holds = footholds_of(plan.trajectory.contact).count
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
