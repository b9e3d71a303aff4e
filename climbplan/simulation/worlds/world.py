"""One world: what robot and terrain really are, beside what the plan believes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.spans import spans_of


@dataclass(frozen=True, eq=False)
class World:
    """N limbs of J joints, R surfaces, P footholds of each limb."""

    mass: float  # factor on the robot's mass
    com: Array  # (3,) of the mass, body frame [m]
    stiffness: Array  # (N, J) factor on each joint's
    gain: float  # factor on that of all motors
    friction: Array  # (R,) factor on each surface's
    surface: Array  # (R,) how far each lies before its place, along its normal; a tube: inward [m]
    tilt: Array  # (R, 2) how far each flat one is turned about two axes in its plane [rad]
    backlash: Array  # (N, J) play of each joint [rad]
    placement: Array  # (N, P, 3) how far each foothold is missed, world frame [m]

    def __eq__(self, other: object) -> bool:
        """The same numbers."""
        return isinstance(other, World) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]  # holds arrays

    def told(self) -> dict[str, Any]:
        """JSON-ready values."""
        return {f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}


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
