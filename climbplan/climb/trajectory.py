"""The playable motion between the planned instants.

A limb's step is: unload (its command returns to the surface while the others take the load),
lift along the normal, swing clear of the terrain, lower, press (commands go to those of the next
instant), push (the body moves on). Toe commands are held in the world frame, so that the planned
penetration and with it the planned force stay while the body moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait import plan_instants
from climbplan.climb.scene import ClimbScene
from climbplan.climb.swing import Swing, swing_path
from climbplan.errors import Infeasible, ReachFailure, UsageError
from climbplan.plans.climb_plan import Forces, Index, Instants, Mask, Rounds, Trajectory
from climbplan.robots.kinematics import inverse, require_reachable, to_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array

# Share of a limb step's time by phase
_UNLOAD, _LIFT, _SWING, _LOWER, _PRESS, _PUSH = 0.15, 0.1, 0.25, 0.15, 0.15, 0.2
_PROBES = 9  # samples of a segment from which its least duration is found
_SPEED_MARGIN = 1.1  # durations exceed what the sampled joint speeds need by this factor
_MOST_SAMPLES = 1_000_000  # a plan of more would take gigabytes to verify


@dataclass(frozen=True)
class _Keyframes:
    """States between which everything moves along straight lines in the world."""

    com: Array  # (F, 3)
    rpy: Array  # (F, 3)
    command: Array  # (F, N, 3) commanded toe positions, world
    contact: Mask  # (F-1, N) toes on their surface during each segment
    share: Array  # (F-1,) nominal part of one limb step's time
    label: tuple[str, ...]  # (F-1,) where each segment stands in the gait


def start_commands(scene: ClimbScene, rounds: Rounds) -> Array:
    """Commanded toe positions (N, 3) of the start posture with all limbs on the surface.

    Raises Infeasible if the start posture cannot hold itself.
    """
    standing = Rounds(
        com=np.repeat(rounds.com[:1], 2, axis=0),
        rpy=np.repeat(rounds.rpy[:1], 2, axis=0),
        toes=np.repeat(rounds.toes[:1], 2, axis=0),
        region=np.repeat(rounds.region[:1], 2, axis=0),
    )
    instants = plan_instants(scene, standing)
    everyone = np.flatnonzero(instants.contact.all(axis=1))[:1]
    one = replace(instants, **{name: value[everyone] for name, value in vars(instants).items()})
    try:
        return plan_forces(scene, one).toe_command[0]
    except Infeasible as error:
        conflicts = [replace(c, where="start posture") for c in error.conflicts]
        raise Infeasible("the start posture cannot hold itself", conflicts) from error


def plan_trajectory(
    scene: ClimbScene, rounds: Rounds, instants: Instants, forces: Forces
) -> Trajectory:
    """Body poses and joint commands at a fixed rate, within joint bounds and speeds.

    The mean speed of the body is the spec's unless joint speeds ask for more time. Every segment
    takes a whole number of samples, so that the samples meet every instant. Raises ReachFailure
    where a command leaves a limb's reach, Infeasible where a swing is blocked, and UsageError for
    a motion of more samples than a plan holds.
    """
    robot = scene.robot
    frames = _keyframes(scene, rounds, instants, forces)
    travel = float(np.linalg.norm(np.diff(rounds.com, axis=0), axis=1).sum())
    steps = rounds.count * robot.limb_count
    nominal = travel / scene.spec.trajectory.speed / steps  # [s] one limb step
    rate = scene.spec.trajectory.rate
    least = np.ceil(_least_durations(robot, frames) * rate)
    count = np.maximum(np.rint(frames.share * nominal * rate), least)  # samples of each segment
    if count.sum() >= _MOST_SAMPLES:
        raise UsageError(
            f"the motion takes {count.sum() / rate:.3g} s, {count.sum():.3g} samples at {rate:g} "
            f"Hz; a plan holds {_MOST_SAMPLES}: raise trajectory.speed or lower trajectory.rate"
        )
    ends = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)

    sample = np.arange(ends[-1] + 1)
    segment = np.clip(np.searchsorted(ends, sample, side="right") - 1, 0, len(count) - 1)
    share = (sample - ends[segment]) / count[segment]
    com, rpy, command = _between(frames, segment, _ease(share))
    angles = _joint_commands(robot, com, rpy, command, [frames.label[s] for s in segment])
    return Trajectory(sample / rate, com, rpy, angles, frames.contact[segment])


def _keyframes(scene: ClimbScene, rounds: Rounds, instants: Instants, forces: Forces) -> _Keyframes:
    names = scene.robot.limb_names
    com, rpy, command = [rounds.com[0]], [rounds.rpy[0]], [start_commands(scene, rounds)]
    contact: list[Mask] = []
    share: list[float] = []
    label: list[str] = []

    def to(toes: Array, body: int | None, touching: Mask, part: float, where: str) -> None:
        com.append(com[-1] if body is None else instants.com[body])
        rpy.append(rpy[-1] if body is None else instants.rpy[body])
        command.append(toes)
        contact.append(touching)
        share.append(part)
        label.append(where)

    for k in range(0, instants.count, 2):
        limb = int(np.flatnonzero(instants.lifted[k])[0])
        where = instants.label(k, names)
        everyone = np.ones(len(names), bool)
        others = ~instants.lifted[k]
        old = rounds.toes[instants.round[k] - 1, limb]
        new = instants.toes[k + 1, limb]
        normals = instants.normal[[k, k + 1], limb]
        swing = Swing(limb, instants.com[k], instants.rpy[k], old, new, normals, where)
        path = swing_path(scene, swing)

        def moved(point: Array, base: Array, limb: int = limb) -> Array:
            out = base.copy()
            out[limb] = point
            return out

        held = forces.toe_command[k]
        to(moved(old, held), None, everyone, _UNLOAD, where)
        to(moved(path[0], held), None, others, _LIFT, where)
        for point in path[1:]:
            to(moved(point, held), None, others, _SWING / (len(path) - 1), where)
        to(moved(new, held), None, others, _LOWER, where)
        pressed = forces.toe_command[k + 1]
        to(pressed, None, everyone, _PRESS, where)
        to(pressed, k + 1, everyone, _PUSH, instants.label(k + 1, names))
    return _Keyframes(
        np.array(com),
        np.array(rpy),
        np.array(command),
        np.array(contact),
        np.array(share),
        tuple(label),
    )


def _ease(share: Array) -> Array:
    """Smooth start and end: 0 and 1 with zero slope."""
    return share**2 * (3.0 - 2.0 * share)


def _between(frames: _Keyframes, segment: Index, share: Array) -> tuple[Array, Array, Array]:
    """Body poses and commands at shares (S,) of segments (S,)."""
    s = share[:, None]
    com = (1 - s) * frames.com[segment] + s * frames.com[segment + 1]
    rpy = (1 - s) * frames.rpy[segment] + s * frames.rpy[segment + 1]
    s = s[..., None]
    return com, rpy, (1 - s) * frames.command[segment] + s * frames.command[segment + 1]


def _least_durations(robot: Robot, frames: _Keyframes) -> Array:
    """Time (F-1,) each segment needs for the joints to stay within their speeds [s]."""
    count = len(frames.share)
    segment = np.repeat(np.arange(count), _PROBES)
    share = np.tile(np.linspace(0.0, 1.0, _PROBES), count)
    com, rpy, command = _between(frames, segment, _ease(share))
    angles = _joint_commands(robot, com, rpy, command, [frames.label[s] for s in segment])
    turned = np.abs(np.diff(angles.reshape(count, _PROBES, *angles.shape[1:]), axis=1))
    fastest = (turned * (_PROBES - 1) / robot.max_joint_speed).max(axis=(1, 2, 3))
    return _SPEED_MARGIN * fastest + 1e-3


def _joint_commands(
    robot: Robot, com: Array, rpy: Array, command: Array, where: list[str]
) -> Array:
    """Joint angles (S, N, 3) that put the toes at their commands; raises ReachFailure."""
    toes_body = to_body(com, rpy, command)
    solution = inverse(robot, toes_body)
    for s in np.flatnonzero(~solution.valid.all(axis=1)):
        try:
            require_reachable(robot, toes_body[s], where[s])
        except ReachFailure as error:
            raise ReachFailure(
                error.limb, f"commanded position {error.reason}", error.missing, error.where
            ) from error
    return solution.best()
