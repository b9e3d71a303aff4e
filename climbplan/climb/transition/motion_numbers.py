"""The numbers of one transition for the program of its motion: parameters, start, bounds.

Rows of what is fixed are open: the search has checked them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.scene.climb_scene import load_wrench
from climbplan.climb.transition.footholds import GOAL, START
from climbplan.climb.transition.motion_statement import POINTS, Shape
from climbplan.climb.transition.parting_faces import (
    LinkPairs,
    links_near,
    parting_faces,
    parting_planes,
)
from climbplan.climb.transition.pose_ways import Sequence, stance_of_move
from climbplan.climb.transition.round_rows import (
    TIES,
    first_ends,
    joint_bounds,
    joint_ends,
    robot_numbers,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import toe_step_limits
from climbplan.climb.transition.stances import Laboratory, stance_forces
from climbplan.program.trajectory import Trajectory
from climbplan.reformulations.nlp_form import Bounds
from climbplan.robots.kinematics import to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.stated_robot import stated_limbs
from climbplan.terrain.surfaces import Region

JOINT_ROOM = 2e-3  # [rad] off joint bounds, so that motions between instants have room
MARGIN = 1e-3  # of friction and torque, taken by the pyramids of the force planner
_MOST_FORCE = 10.0  # of a limb, in units of the weight


@dataclass(frozen=True)
class MotionNumbers:
    """One run's data."""

    parameters: dict[str, Array]
    start: Array
    bounds: Bounds


def shape_of(
    scene: TransitionScene, rounds: int, parted: bool = False, beside: LinkPairs = ()
) -> Shape:
    """The shape of the program of a scene; parted: with rows that keep limbs off things.

    beside: links of two limbs that are kept apart then.
    """
    robot = scene.robot
    pieces = robot.joint_count if robot.capsules is None else robot.capsules.joint.shape[1]
    return Shape(
        pieces=pieces if parted else 0,
        beside=beside if parted else (),
        rounds=rounds,
        stated=stated_limbs(scene.robot),
        solids=len(scene.terrain.solids),
        edges=max(len(s.b) for s in scene.terrain.surfaces if isinstance(s, Region)),
    )


def toes_of(lab: Laboratory, sequence: Sequence) -> Array:
    """(M + 1, N, 3) as the search has them."""
    limb = np.arange(lab.scene.robot.limb_count)
    return lab.footholds.toe[limb, np.array(sequence.states)]


def open_footholds(sequence: Sequence) -> BoolArray:
    """(M + 1, N) toes on footholds between, whose place is open."""
    states = np.array(sequence.states)
    return (states != START) & (states != GOAL)


def searched_forces(lab: Laboratory, sequence: Sequence) -> tuple[Array, Array]:
    """Forces (M, N, 3) in units of the weight and torque use (M,) at the search's poses."""
    stances = np.array(
        [stance_of_move(a, b) for a, b in zip(sequence.states, sequence.states[1:], strict=False)]
    )
    found = stance_forces(lab, stances, np.array(sequence.poses)[:-1])
    return found.force / lab.scene.robot.weight, found.use


@dataclass(frozen=True)
class Kept:
    """What toes keep in hand, by the spec's bounds and a share of its margins."""

    pressure: float  # [weight]
    reserve: float  # of it, that may go missing before a toe slips [weight]
    least_depth: float | None  # of commands, to first order [m]; None: not asked
    depth: float | None  # of commands, where free toes would be [m]; None: not asked
    torque: float  # part of its limit that every motor has left


def kept_by(scene: TransitionScene, share: float) -> Kept:
    """The spec's bounds with a share of its margins."""
    spec, margins = scene.spec, scene.spec.margins
    weight = scene.robot.weight
    pressure = max(spec.search.least_load, spec.force.least_pressure / weight)
    depth = spec.force.least_depth
    if not margins.asked or share <= 0:
        return Kept(pressure, 0.0, depth, None, 0.0)
    return Kept(
        max(pressure, share * margins.pressure),
        share * margins.friction,
        depth,
        share * margins.depth,
        share * margins.torque,
    )


def motion_numbers(
    lab: Laboratory,
    stated: Trajectory,
    sequence: Sequence,
    safety_torque: float,
    share: float = 0.0,
    parted: bool = False,
    beside: LinkPairs = (),
    joint_room: float = JOINT_ROOM,
) -> MotionNumbers:
    """Numbers of a sequence; safety_torque: least S_tau, share: of the margins asked for.

    parted: with rows that keep limbs off the terrain and the body, and the links of `beside` off
    one another. joint_room: of angles and commands off their bounds [rad].
    """
    kept = kept_by(lab.scene, share)
    scene = lab.scene
    poses = np.array(sequence.poses)[:-1]
    pose = np.concatenate([lab.poses.com[poses], lab.poses.rpy[poses]], axis=1)
    force, use = searched_forces(lab, sequence)
    in_use = np.where(np.isfinite(use), use, 1 / safety_torque)[:, None]
    turn = np.full(3, np.deg2rad(scene.spec.posture.rotation_limit_deg))
    body = np.stack([scene.start.com, scene.goal.com])
    span = scene.spec.posture.steps.com_max
    pose_lower, pose_upper = pose.copy(), pose.copy()
    pose_lower[0], pose_upper[0] = first_ends(scene)
    pose_lower[1:] = np.concatenate([body.min(axis=0) - span, -turn])
    pose_upper[1:] = np.concatenate([body.max(axis=0) + span, turn])
    m = len(poses)
    toe = toes_of(lab, sequence)[1:].reshape(m, -1)
    room = np.where(np.repeat(open_footholds(sequence)[1:], 3, axis=1), np.inf, 0.0)
    most = np.repeat(np.where(sequence.moved, 0.0, _MOST_FORCE), 3, axis=1)
    largest = (1 - MARGIN) * min(1 / safety_torque, 1 - kept.torque)
    start = {"pose": pose, "toe": toe, "force": force.reshape(m, -1), "s": in_use}
    lower = {"pose": pose_lower, "toe": toe - room, "force": -most, "s": np.zeros(1)}
    upper = {"pose": pose_upper, "toe": toe + room, "force": most, "s": np.array([largest])}
    toes, limbs = _toes_at_points(lab, sequence), stated_limbs(scene.robot)
    at_toes = limbs.at_toes(scene.robot, toes)
    asked = np.swapaxes(_asked(scene, sequence), 1, 2)[..., None]  # (M, POINTS, N, 1)
    for name in limbs.found:
        here = at_toes[name]
        ends = (np.full(here.shape[-1], -np.inf), np.full(here.shape[-1], np.inf))
        if name == "angles":
            ends = joint_ends(scene.robot, joint_room)
        # Where no row ties them they stay: what starts there is fixed, or nobody asks
        start[name] = here.reshape(m, -1)
        lower[name] = np.where(asked, ends[0], here).reshape(m, -1)
        upper[name] = np.where(asked, ends[1], here).reshape(m, -1)
    given = {name: at_toes[name] for name in limbs.given}
    if parted:
        given |= parting_faces(scene, pose[:, :3], pose[:, 3:], toes, asked[..., 0])
        given |= parting_planes(scene, toes, asked[..., 0], sequence.moved, beside)
    return MotionNumbers(
        _parameters(lab, sequence, kept, given),
        stated.point(start),
        Bounds(
            stated.point(lower),
            stated.point(upper),
            *_row_bounds(scene, stated, sequence, kept, joint_room),
        ),
    )


def _open_poses(scene: TransitionScene, rounds: int) -> BoolArray:
    """(M, 1) whether the pose of a round is open: but for the first, unless it may be shifted."""
    return ((np.arange(rounds) > 0) | (scene.spec.posture.steps.shift_max > 0))[:, None]


def _asked(scene: TransitionScene, sequence: Sequence) -> BoolArray:
    """(M, N, POINTS) which toes are to be in reach: old, new, hovering over old, over new."""
    open_toes, moved = open_footholds(sequence), sequence.moved
    later = _open_poses(scene, len(moved))
    old, new = later | open_toes[:-1], moved & (later | open_toes[1:])
    return np.stack([old, new, moved & old, new], axis=-1)


def links_beside(lab: Laboratory, sequence: Sequence, met: Rounds | None = None) -> LinkPairs:
    """Links of two limbs that come close where the search has them, or in a motion that met."""
    moved = sequence.moved
    pairs = links_near(lab.scene, _toes_at_points(lab, sequence), moved)
    if met is not None:
        own = links_near(lab.scene, _toes_at_points(lab, sequence, met), moved)
        pairs = tuple(sorted({*pairs, *own}))
    return pairs


def _toes_at_points(lab: Laboratory, sequence: Sequence, rounds: Rounds | None = None) -> Array:
    """Toes (M, POINTS, N, 3) old, new and hovering over both, body frame.

    rounds: a motion of the sequence; left out, as the search has it.
    """
    scene, holds = lab.scene, lab.footholds
    limb, states = np.arange(scene.robot.limb_count), np.array(sequence.states)
    poses = np.array(sequence.poses)[:-1]
    ends = (states[:-1], states[1:])
    if rounds is None:
        com, rpy = lab.poses.com[poses], lab.poses.rpy[poses]
        points = [holds.toe[limb, state] for state in ends]
    else:
        com, rpy = rounds.com[:-1], rounds.rpy[:-1]
        points = [rounds.toes[:-1], rounds.toes[1:]]
    lift = scene.spec.trajectory.lift
    points += [p + lift * holds.normal[limb, s] for p, s in zip(points, ends, strict=True)]
    return np.stack([to_body(com, rpy, p) for p in points], axis=1)


def _parameters(
    lab: Laboratory, sequence: Sequence, kept: Kept, given: dict[str, Array]
) -> dict[str, Array]:
    """given: of limbs at their toes."""
    scene, robot, holds = lab.scene, lab.scene.robot, lab.footholds
    limb, states = np.arange(robot.limb_count), np.array(sequence.states)
    old, new = states[:-1], states[1:]  # (M, N)
    poses = np.array(sequence.poses)[:-1]
    com, rpy = lab.poses.com[poses], lab.poses.rpy[poses]
    shape = shape_of(scene, len(old))
    mu = holds.mu[limb, old] / scene.spec.force.safety_friction * (1 - MARGIN)
    region = holds.region[limb, new]
    edges = np.zeros((*region.shape, shape.edges, 3))
    ends, plane = np.ones((*region.shape, shape.edges)), np.empty(region.shape)
    for index in np.unique(region):
        surface, here = scene.terrain.surfaces[index], region == index
        if not isinstance(surface, Region):
            raise TypeError("transitions stand on flat surfaces")
        edges[here, : len(surface.b)], ends[here, : len(surface.b)] = surface.A, surface.b
        plane[here] = surface.offset

    hull = com[:, None] + robot.body_hull @ np.swapaxes(rotation_world_body(rpy), -1, -2)
    faces, offsets = np.empty((len(com), shape.solids, 3)), np.empty((len(com), shape.solids))
    for s, solid in enumerate(scene.terrain.solids):
        best = (hull @ solid.A.T - solid.b).min(axis=1).argmax(axis=1)
        faces[:, s], offsets[:, s] = solid.A[best], solid.b[best]
    every_round = {
        "normal_old": holds.normal[limb, old],
        "normal_new": holds.normal[limb, new],
        "mu": np.where(old == new, mu, 0.0),
        **given,
        "edge_row": edges,
        "edge_end": ends,
        "plane": plane,
        "face": faces,
        "face_end": offsets,
        "load": load_wrench(scene.spec, robot, rpy) / robot.weight,
    }
    return {
        **robot_numbers(scene, holds.toe[limb, states[0]]),
        **{name: value.reshape(len(old), -1).T for name, value in every_round.items()},
        "hull": robot.body_hull.reshape(-1, 1),
        "lift": np.array([[scene.spec.trajectory.lift]]),
        "least_load": np.array([[kept.pressure]]),
        "least_depth": np.array([[kept.least_depth or 0.0]]),
        "margin_depth": np.array([[kept.depth or 0.0]]),
        "reserve": np.array([[kept.reserve]]),
    }


def _row_bounds(
    scene: TransitionScene, stated: Trajectory, sequence: Sequence, kept: Kept, joint_room: float
) -> tuple[Array, Array]:
    """Bounds that are numbers of the scene, and which rows hold; masks are (M, rows of a round)."""
    robot, spec = scene.robot, scene.spec
    open_toes, moved = open_footholds(sequence), sequence.moved
    was_open, is_open = open_toes[:-1], open_toes[1:]
    m, n = moved.shape
    later = _open_poses(scene, m)
    held, either = ~moved, later | (np.arange(m) + 1 < m)[:, None]
    check, sizes = _asked(scene, sequence).reshape(m, POINTS * n), stated.sizes()
    joints = robot.joint_count
    steps = spec.posture.steps
    turn = np.deg2rad(steps.rotation_max_deg)
    given = {
        "force.command": joint_bounds(robot, joint_room),
        "steps.toe": (-np.inf, (toe_step_limits(scene) - 1e-6) ** 2),
        "steps.com": (-np.inf, (steps.com_max - 1e-6) ** 2),
        "steps.rotation": (-turn, turn),
        "body.clearance": (spec.posture.body_clearance + 1e-6, np.inf),
    }
    if "transition.joints" in sizes:
        given["transition.joints"] = joint_bounds(robot, joint_room, POINTS)
    placed = moved & is_open
    ties = [name for name in TIES if name in sizes]
    holds = {
        **{name: np.repeat(check, sizes[name] // check.size, axis=1) for name in ties},
        "force.friction": held,
        "force.contact": held,
        "force.torque": np.repeat(held, 2 * joints, axis=1),
        "force.inward": held & (kept.least_depth is not None),
        "force.inside": held & (kept.depth is not None),
        "force.command": np.repeat(held, joints, axis=1),
        "foothold.inside": np.repeat(placed, sizes["foothold.inside"] // (m * n), axis=1),
        "steps.toe": moved & (was_open | is_open),
        "foothold.stays": np.repeat(held & is_open, 3, axis=1),
        "foothold.plane": placed,
        "steps.com": either,
        "steps.rotation": either,
        "body.clearance": later,
    }
    return stated.bounded(given, holds)
