"""The playable motion sample by sample: what stands where, and between which instants.

Contact flags tell how many steps are behind a sample, and with that where every standing toe is
and between which instants body and commands have to be. A toe that stands is held by the terrain,
not by its command: its limb is built anew from the place it stands on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.feet import foot_arm
from climbplan.climb.check.anew.gait import Gait, gait_of
from climbplan.climb.check.anew.kinematics import (
    Limbs,
    StandingLimbs,
    body_axes,
    limbs_at,
    standing_limbs,
)
from climbplan.climb.check.anew.soles import lying
from climbplan.climb.check.anew.weights import weight_on
from climbplan.climb.check.normals import normals_of
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import ClimbPlan


@dataclass(frozen=True)
class Motion:
    """What the samples are between. T samples, N limbs, K instants."""

    subject: Subject
    gait: Gait
    lifted: BoolArray  # (T, N)
    done: IntArray  # (T,) steps completed
    ground: Array  # (T, N, 3) where each limb stands, or stood
    arm: Array | None  # (T, N, 3) from there to where its foot touches; None for points [m]
    soles: Array | None  # (T, N, 3, 3) rows of flat feet that stand there
    stood: IntArray  # (T, N) round of that foothold
    bound_for: IntArray  # (T, N) of the one that a lifted limb is on its way to; -1 for the others
    commanded: Limbs  # as the joint commands would have them in free space
    standing: StandingLimbs  # reaching for `ground`

    def at(self, sample: int, *parts: int) -> str:
        """Sample, step of the gait, limb and joint in the robot's terms."""
        in_the_air = bool(self.lifted[sample].any())
        k = 2 * int(self.done[sample]) - (0 if in_the_air else 1)
        k = min(max(k, 0), self.subject.plan.instants.count - 1)
        label = self.subject.at(k, *parts)
        return f"{self.subject.at_time(sample)}, {label}"


def motion_of(subject: Subject) -> Motion:
    """The motion of a plan under verification."""
    plan = subject.plan
    trajectory, rounds, robot = plan.trajectory, plan.rounds, plan.robot
    lifted = ~trajectory.contact
    before = np.vstack([np.zeros((1, robot.limb_count), bool), lifted[:-1]])
    gait = gait_of(plan)
    placed = (before & ~lifted).cumsum(axis=0)
    stood = _stood(gait, placed)
    ground = rounds.toes[stood, _limbs_of(plan)]
    landed = (before.any(axis=1) & ~lifted.any(axis=1)).cumsum()
    arm, soles = _arms(plan, stood, ground)
    axes = body_axes(trajectory.rpy)
    commanded = limbs_at(robot, trajectory.com, axes, trajectory.joint_command)
    # Commands may lie beyond full stretch: the planned angles tell which way a limb bends.
    k = np.clip(2 * landed, 0, plan.instants.count - 1)
    planned = plan.instants.joint_angles[k]
    return Motion(
        subject=subject,
        gait=gait,
        lifted=lifted,
        done=np.minimum(landed, gait.steps),
        ground=ground,
        arm=arm,
        soles=soles,
        stood=stood,
        bound_for=np.where(lifted, _stood(gait, placed + 1), -1),
        commanded=commanded,
        standing=standing_limbs(
            robot, trajectory.com, axes, ground, planned, trajectory.joint_command, arm, soles
        ),
    )


def _arms(plan: ClimbPlan, stood: IntArray, ground: Array) -> tuple[Array | None, Array | None]:
    """From toes on footholds of rounds (T, N) to where their feet touch; None for point toes.

    And rows (T, N, 3, 3) of soles there; None for feet that are not flat.
    """
    if plan.robot.foot is None:
        return None, None
    region, normal = plan.rounds.region[stood, _limbs_of(plan)], np.zeros_like(ground)
    for index, surface in enumerate(plan.terrain.surfaces):
        here = region == index
        normal[here] = normals_of(surface, ground[here])
    soles = None if plan.robot.sole is None else lying(plan.robot.sole, normal)
    return foot_arm(plan.robot, normal), soles


def _limbs_of(plan: ClimbPlan) -> IntArray:
    return np.arange(plan.robot.limb_count)


def _stood(gait: Gait, counted: IntArray) -> IntArray:
    """(T, N) rounds whose footholds limbs are on that were placed so often (T, N)."""
    rows = np.zeros_like(counted)
    for limb in range(counted.shape[1]):
        own = np.concatenate([[0], gait.round[gait.moved[:, limb]]])
        rows[:, limb] = own[np.minimum(counted[:, limb], len(own) - 1)]
    return rows


def load_of(motion: Motion) -> Array:
    """(T, 6) load on the body: the external one of the pose it waits in, or on its way between two.

    And the weight, where it acts with limbs that stand and swing as they do.
    """
    plan = motion.subject.plan
    stations = np.hstack([motion.gait.station_com, motion.gait.station_rpy])
    # Instants 2 s and 2 s - 1 both have the body at station s.
    count = len(stations)
    at_station = plan.instants.external_wrench[
        np.minimum(2 * np.arange(count), plan.instants.count - 1)
    ]
    last = motion.done
    first = np.maximum(last - 1, 0)
    pose = np.hstack([plan.trajectory.com, plan.trajectory.rpy])
    along = stations[last] - stations[first]
    square = (along**2).sum(axis=1)
    share = ((pose - stations[first]) * along).sum(axis=1)
    share = np.clip(np.divide(share, square, out=np.ones_like(share), where=square > 0), 0, 1)
    outer = (1 - share[:, None]) * at_station[first] + share[:, None] * at_station[last]
    return np.asarray(
        outer + weight_on(plan.robot, body_axes(plan.trajectory.rpy), angles_of(motion))
    )


def angles_of(motion: Motion) -> Array:
    """(T, N, J) of limbs that reach for where they stand, or swing as they are commanded."""
    command = motion.subject.plan.trajectory.joint_command
    return np.where(motion.lifted[..., None], command, motion.standing.angles)


def instants_of(motion: Motion) -> IntArray:
    """(T,) an instant whose surfaces the limbs of each sample stand on."""
    last = motion.subject.plan.instants.count - 1
    k = np.clip(2 * motion.done - 1, 0, last)
    pressing = np.where(motion.lifted.any(axis=1), np.minimum(k + 1, last), k)
    return np.where(motion.done == 0, 0, pressing)
