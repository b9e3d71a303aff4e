"""The state of the motion at its samples: standing limbs, footholds and neighbouring instants.

Contact flags give the number of completed steps. It determines where every standing toe is, and
between which instants body and commands are. A standing toe is held by the terrain, not by its
command, so that its limb is computed from its foothold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.feet import compute_contact_arm
from climbplan.climb.check.anew.gait import ClimbGait, reconstruct_gait
from climbplan.climb.check.anew.inertia import Inertia, compute_inertia
from climbplan.climb.check.anew.kinematics import (
    HeldLimbs,
    Limbs,
    build_limbs,
    compute_body_axes,
    solve_standing_limbs,
)
from climbplan.climb.check.anew.soles import compute_sole_axes
from climbplan.climb.check.anew.weights import compute_weight_wrench
from climbplan.climb.check.normals import compute_normals
from climbplan.climb.check.spec import read_payload
from climbplan.climb.check.subject import Subject
from climbplan.climb.plan.climb_plan import ClimbPlan


@dataclass(frozen=True)
class MotionState:
    """The state of T samples with N limbs, between K instants."""

    subject: Subject
    gait: ClimbGait
    lifted: BoolArray  # (T, N)
    steps_done: IntArray  # (T,) steps completed
    ground: Array  # (T, N, 3) where each limb stands, or stood
    arm: Array | None  # (T, N, 3) from there to where its foot touches; None for points [m]
    soles: Array | None  # (T, N, 3, 3) rows of flat feet that stand there
    foothold_round: IntArray  # (T, N) round of that foothold
    next_round: IntArray  # (T, N) of the one that a lifted limb is on its way to; -1 for the others
    commanded: Limbs  # as the joint commands would have them in free space
    standing: HeldLimbs  # reaching for `ground`

    def describe_sample(self, sample: int, *parts: int) -> str:
        """Describe sample, step of the gait, limb and joint in the robot's terms."""
        is_swinging = bool(self.lifted[sample].any())
        k = 2 * int(self.steps_done[sample]) - (0 if is_swinging else 1)
        k = min(max(k, 0), self.subject.plan.instants.count - 1)
        label = self.subject.describe_instant(k, *parts)
        return f"{self.subject.describe_time(sample)}, {label}"


def reconstruct_motion(subject: Subject) -> MotionState:
    """Reconstruct the motion of a plan under verification."""
    plan = subject.plan
    trajectory, rounds, robot = plan.trajectory, plan.rounds, plan.robot
    lifted = ~trajectory.contact
    was_lifted = np.vstack([np.zeros((1, robot.limb_count), bool), lifted[:-1]])
    gait = reconstruct_gait(plan)
    num_placed = (was_lifted & ~lifted).cumsum(axis=0)
    foothold_round = _find_foothold_rounds(gait, num_placed)
    ground = rounds.toes[foothold_round, _list_limbs(plan)]
    num_landed = (was_lifted.any(axis=1) & ~lifted.any(axis=1)).cumsum()
    arm, soles = _compute_foot_contacts(plan, foothold_round, ground)
    axes = compute_body_axes(trajectory.rpy)
    commanded = build_limbs(robot, trajectory.com, axes, trajectory.joint_command)
    # Commands may lie beyond full stretch: the planned angles tell which way a limb bends.
    k = np.clip(2 * num_landed, 0, plan.instants.count - 1)
    planned = plan.instants.joint_angles[k]
    return MotionState(
        subject=subject,
        gait=gait,
        lifted=lifted,
        steps_done=np.minimum(num_landed, gait.steps),
        ground=ground,
        arm=arm,
        soles=soles,
        foothold_round=foothold_round,
        next_round=np.where(lifted, _find_foothold_rounds(gait, num_placed + 1), -1),
        commanded=commanded,
        standing=solve_standing_limbs(
            robot,
            trajectory.com,
            axes,
            ground,
            initial=planned,
            command=trajectory.joint_command,
            arm=arm,
            soles=soles,
        ),
    )


def _compute_foot_contacts(
    plan: ClimbPlan, foothold_round: IntArray, ground: Array
) -> tuple[Array | None, Array | None]:
    """Return vectors from toes on footholds (T, N) to their contact points; None for point feet.

    The second result are the axes (T, N, 3, 3) of soles there; None for feet that are not flat.
    """
    if plan.robot.foot is None:
        return None, None
    region, normal = plan.rounds.region[foothold_round, _list_limbs(plan)], np.zeros_like(ground)
    for index, surface in enumerate(plan.terrain.surfaces):
        on_surface = region == index
        normal[on_surface] = compute_normals(surface, ground[on_surface])
    soles = None if plan.robot.sole is None else compute_sole_axes(plan.robot.sole, normal)
    return compute_contact_arm(plan.robot, normal), soles


def _list_limbs(plan: ClimbPlan) -> IntArray:
    """Return the indices of all limbs."""
    return np.arange(plan.robot.limb_count)


def _find_foothold_rounds(gait: ClimbGait, num_placed: IntArray) -> IntArray:
    """Return the rounds (T, N) of the footholds of limbs with given numbers of placings (T, N)."""
    rounds_of_limbs = np.zeros_like(num_placed)
    for limb in range(num_placed.shape[1]):
        foothold_rounds = np.concatenate([[0], gait.round[gait.moving_limbs[:, limb]]])
        rounds_of_limbs[:, limb] = foothold_rounds[
            np.minimum(num_placed[:, limb], len(foothold_rounds) - 1)
        ]
    return rounds_of_limbs


def compute_motion_inertia(motion: MotionState) -> Inertia:
    """Return the inertial load of a motion that is timed by its dynamics; zero for others."""
    plan, angles = motion.subject.plan, select_angles(motion)
    trajectory = plan.trajectory
    if not trajectory.is_paced:
        return Inertia(np.zeros((len(trajectory.time), 6)), np.zeros(angles.shape))
    return compute_inertia(
        plan.robot,
        trajectory.com,
        compute_body_axes(trajectory.rpy),
        angles,
        step=float(trajectory.time[-1] - trajectory.time[0]) / (len(trajectory.time) - 1),
        payload=read_payload(plan),
    )


def compute_load(motion: MotionState) -> Array:
    """Return the load on the body (T, 6), interpolated between its stations, with the weight."""
    plan = motion.subject.plan
    stations = np.hstack([motion.gait.station_com, motion.gait.station_rpy])
    # Instants 2 s and 2 s - 1 both have the body at station s.
    count = len(stations)
    at_station = plan.instants.external_wrench[
        np.minimum(2 * np.arange(count), plan.instants.count - 1)
    ]
    last = motion.steps_done
    first = np.maximum(last - 1, 0)
    pose = np.hstack([plan.trajectory.com, plan.trajectory.rpy])
    station_change = stations[last] - stations[first]
    square = (station_change**2).sum(axis=1)
    progress = ((pose - stations[first]) * station_change).sum(axis=1)
    progress = np.clip(
        np.divide(progress, square, out=np.ones_like(progress), where=square > 0), 0, 1
    )
    external_load = (1 - progress[:, None]) * at_station[first] + progress[:, None] * at_station[
        last
    ]
    return np.asarray(
        external_load
        + compute_weight_wrench(
            plan.robot, compute_body_axes(plan.trajectory.rpy), select_angles(motion)
        )
    )


def select_angles(motion: MotionState) -> Array:
    """Return joint angles (T, N, J), those of standing limbs or those commanded."""
    command = motion.subject.plan.trajectory.joint_command
    return np.where(motion.lifted[..., None], command, motion.standing.angles)


def select_instants(motion: MotionState) -> IntArray:
    """Return an instant (T,) whose surfaces the limbs of each sample stand on."""
    last = motion.subject.plan.instants.count - 1
    k = np.clip(2 * motion.steps_done - 1, 0, last)
    instant = np.where(motion.lifted.any(axis=1), np.minimum(k + 1, last), k)
    return np.where(motion.steps_done == 0, 0, instant)
