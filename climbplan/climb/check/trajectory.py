"""The playable motion against the instants it has to pass (samples as in `motion_state`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.capsules import capsules_at
from climbplan.climb.check.anew.kinematics import (
    body_axes,
    limbs_at,
)
from climbplan.climb.check.anew.soles import soles_at
from climbplan.climb.check.clearance import (
    judge_capsules,
    judge_link_depths,
    link_depths,
)
from climbplan.climb.check.feet import judge_feet, judge_soles
from climbplan.climb.check.motion_state import Motion, motion_of
from climbplan.climb.check.pressing import pressing_checks
from climbplan.climb.check.self_collision import judge_self_collision
from climbplan.climb.check.statics import told_of_sag
from climbplan.climb.check.subject import Subject
from climbplan.robots.joint_units import format_bound_margin
from climbplan.verification.check import Check, judge, judge_worst

_STRIDE = 5e-3  # [m] a swinging toe is looked at this often
_MOST_PIECES = 16


def trajectory_checks(subject: Subject) -> Iterator[Check]:
    """Rate, gait, body path, commands, joint bounds and speeds, clearance."""
    yield _rate(subject)
    yield _ends(subject)
    motion = motion_of(subject)
    yield _sequence(motion)
    yield _body(motion)
    for check in pressing_checks(motion):
        yield told_of_sag(check) if subject.sags else check
    yield _instants(motion)
    yield from _joints(motion)
    yield from _clearance(motion)


def _rate(subject: Subject) -> Check:
    time = subject.plan.trajectory.time
    step = np.diff(time)
    uneven = np.abs(step - (time[-1] - time[0]) / (len(time) - 1))
    uneven = np.where(step > 0, uneven, np.inf)
    return judge_worst("trajectory.rate", uneven, lambda s: subject.at_time(s))


def _ends(subject: Subject) -> Check:
    rounds, trajectory = subject.plan.rounds, subject.plan.trajectory
    off = np.vstack(
        [
            trajectory.com[[0, -1]] - rounds.com[[0, -1]],
            trajectory.rpy[[0, -1]] - rounds.rpy[[0, -1]],
        ]
    )
    names = ("start, position", "end, position", "start, rotation", "end, rotation")
    return judge_worst("trajectory.ends", np.abs(off).max(axis=1), lambda row: names[row])


def _sequence(motion: Motion) -> Check:
    """Limbs lift together as in the instants, and the steps come in turn."""
    lifted, moved = motion.lifted, motion.gait.moved
    flying: BoolArray = np.asarray(lifted.any(axis=1))
    starts = np.flatnonzero(flying & ~np.append(False, flying[:-1]))
    crowded = np.flatnonzero(lifted.sum(axis=1) > moved.sum(axis=1).max())
    if len(crowded):
        sample = int(crowded[0])
        place = f"{motion.at(sample)}: {lifted[sample].sum()} limbs lifted at once"
        return judge("trajectory.sequence", float(len(crowded)), place)
    if flying[-1]:
        return judge("trajectory.sequence", 1.0, "the motion ends with a limb lifted")
    step = np.cumsum(np.isin(np.arange(len(lifted)), starts)) - 1
    planned = moved[np.clip(step, 0, len(moved) - 1)] & flying[:, None]
    wrong = np.argwhere(lifted != planned)
    if len(wrong):
        sample, limb = (int(i) for i in wrong[0])
        name = motion.subject.limb(limb)
        out_of_turn = "lifts" if lifted[sample, limb] else "stays down"
        place = f"{motion.subject.at_time(sample)}: {name} {out_of_turn} out of turn"
        return judge("trajectory.sequence", float(len(wrong)), place)
    missing = abs(len(starts) - len(moved))
    return judge(
        "trajectory.sequence",
        float(missing),
        f"{len(starts)} steps, expected {len(moved)}" if missing else "",
    )


def _body(motion: Motion) -> Check:
    """The body waits while limbs are in the air and then moves straight on to its next station."""
    plan = motion.subject.plan
    stations = np.hstack([motion.gait.station_com, motion.gait.station_rpy])
    first = np.hstack([plan.rounds.com[:1], plan.rounds.rpy[:1]])  # from where it starts out
    before = np.vstack([first, stations[:-1]])
    end = stations[motion.done]
    waits: BoolArray = np.asarray(motion.lifted.any(axis=1))
    start = np.where(waits[:, None], end, before[motion.done])
    pose = np.hstack([plan.trajectory.com, plan.trajectory.rpy])
    off = _off_segment(pose, start, end)  # one radian counts as one metre
    return judge_worst("trajectory.body", off, motion.at)


def _instants(motion: Motion) -> Check:
    """Some sample comes close to each instant in body pose and commands of loaded limbs."""
    plan = motion.subject.plan
    instants, trajectory = plan.instants, plan.trajectory
    k = 2 * motion.done - np.where(motion.lifted.any(axis=1), 0, 1)
    off = np.full(instants.count, np.inf)
    samples = np.flatnonzero((k >= 0) & (k < instants.count))
    k = k[samples]
    command = np.abs(trajectory.joint_command[samples] - plan.forces.joint_command[k])
    miss = np.where(instants.contact[k], command.max(axis=-1), 0.0).max(axis=1)
    body = np.linalg.norm(trajectory.com[samples] - instants.com[k], axis=-1)
    turn = np.abs(trajectory.rpy[samples] - instants.rpy[k]).max(axis=-1)
    np.minimum.at(off, k, np.maximum(np.maximum(miss, body), turn))
    return judge_worst("trajectory.instants", off, motion.subject.at)


def _joints(motion: Motion) -> Iterator[Check]:
    """Bounds of commanded and standing joint angles, speeds, and reach of standing limbs."""
    plan = motion.subject.plan
    robot, command = plan.robot, plan.trajectory.joint_command
    stands = np.where(motion.lifted[..., None], command, motion.standing.angles)
    over = np.full(command.shape, -np.inf)
    for angles in (command, stands):
        over = np.maximum(over, np.maximum(robot.joint_lower - angles, angles - robot.joint_upper))
    margin = format_bound_margin(robot, over)
    span = (robot.joint_upper - robot.joint_lower) / 2
    yield judge_worst("trajectory.joint_bounds", over, motion.at, margin, used=1 + over / span)

    step = np.diff(plan.trajectory.time)[:, None, None]
    speed = np.abs(np.diff(command, axis=0)) / step
    used = speed / robot.max_joint_speed
    margin = f"{100 * used.max():.0f} % of the limit"
    excess = speed - robot.max_joint_speed
    yield judge_worst("trajectory.joint_speed", excess, motion.at, margin, used)
    missing = np.where(motion.lifted, 0.0, motion.standing.missing)
    yield judge_worst("trajectory.reach", missing, motion.at)


def _clearance(motion: Motion) -> Iterator[Check]:
    """Links of standing and of swinging limbs keep out of solids, between samples too."""
    points = np.where(
        motion.lifted[..., None, None], motion.commanded.points, motion.standing.points
    )
    trajectory = motion.subject.plan.trajectory
    angles = np.where(motion.lifted[..., None], trajectory.joint_command, motion.standing.angles)
    steps = [_Poses(trajectory.com, body_axes(trajectory.rpy), angles, points)]
    # A toe that swings far between two samples: joints turn evenly from one to the other.
    swinging = (motion.lifted[1:] & motion.lifted[:-1]).any(axis=1)
    strides = np.linalg.norm(np.diff(motion.commanded.toe, axis=0), axis=-1).max(axis=1)
    coarse = np.flatnonzero(swinging & (strides > _STRIDE))
    pieces = int(min(np.ceil(strides[coarse].max(initial=0.0) / _STRIDE), _MOST_PIECES))
    for piece in range(1, pieces):
        steps.append(_swinging_between(motion, steps[0], coarse, piece / pieces))
    rows = np.concatenate([np.arange(len(points)), *[coarse] * (len(steps) - 1)])
    poses = _Poses(
        *(np.concatenate([vars(step)[part.name] for step in steps]) for part in fields(_Poses))
    )
    chains = poses.points
    capsules = tuple(capsules_at(motion.subject.plan.robot, **vars(poses)))
    depth = link_depths(motion.subject, chains, 0.0)
    worst = float(depth.max(initial=-np.inf))
    margin = f"{1e3 * worst:.1f} mm deep" if worst > 1e-6 else "no link inside a solid"

    def moment(row: int) -> str:
        return motion.at(int(rows[row]))

    yield judge_link_depths("trajectory.clearance", motion.subject, depth, moment, margin)
    yield judge_capsules("trajectory.capsules", motion.subject, capsules, moment)
    yield judge_self_collision(
        "trajectory.self_collision", motion.subject, capsules, poses.com, poses.axes, moment
    )
    toes, robot = chains[..., -1, :], motion.subject.plan.robot
    if robot.sole is None:
        yield from judge_feet("trajectory.feet", motion.subject, toes, moment)
    else:
        soles = soles_at(robot, poses.axes, poses.angles)
        yield from judge_soles("trajectory.feet", motion.subject, toes, soles, moment)
    if motion.subject.plan.terrain.scan is not None:
        from climbplan.climb.check.scan_links import contacts_on, judge_scan_links

        contacts = contacts_on(motion.subject, motion.stood, motion.bound_for).at(rows)
        yield judge_scan_links("scan.trajectory", motion.subject, capsules, contacts, moment)


@dataclass(frozen=True)
class _Poses:
    """Body and limbs at P moments."""

    com: Array  # (P, 3) [m]
    axes: Array  # (P, 3, 3) of the body, as rows
    angles: Array  # (P, N, J) [rad]
    points: Array  # (P, N, J + 1, 3) joints and toes [m]


def _swinging_between(motion: Motion, at: _Poses, samples: IntArray, share: float) -> _Poses:
    """Limbs a share of the way to the next of S samples; standing ones stay put."""
    trajectory = motion.subject.plan.trajectory

    def between(values: Array) -> Array:
        return (1 - share) * values[samples] + share * values[samples + 1]

    com, axes = between(trajectory.com), body_axes(between(trajectory.rpy))
    angles = between(trajectory.joint_command)
    limbs = limbs_at(motion.subject.plan.robot, com, axes, angles)
    swings = motion.lifted[samples] & motion.lifted[samples + 1]
    return _Poses(
        com,
        axes,
        np.where(swings[..., None], angles, at.angles[samples]),
        np.where(swings[..., None, None], limbs.points, at.points[samples]),
    )


def _off_segment(points: Array, starts: Array, ends: Array) -> Array:
    """Distances (...) of points (..., D) from segments."""
    along = ends - starts
    square = (along**2).sum(axis=-1)
    share = ((points - starts) * along).sum(axis=-1)
    share = np.clip(np.divide(share, square, out=np.zeros_like(share), where=square > 0), 0, 1)
    off: Array = np.linalg.norm(points - starts - share[..., None] * along, axis=-1)
    return off
