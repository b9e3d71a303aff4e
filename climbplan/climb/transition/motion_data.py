"""Data of one transition for the motion program: parameters, start and bounds.

Constraints on fixed quantities have infinite bounds, as the search has checked them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.scene.climb_scene import compute_load_wrench
from climbplan.climb.transition.footholds import GOAL, START
from climbplan.climb.transition.motion_formulation import POINTS, MotionDimensions
from climbplan.climb.transition.pose_paths import ContactSequence, get_stance
from climbplan.climb.transition.round_constraints import (
    TIES,
    build_joint_row_bounds,
    build_robot_parameters,
    compute_first_pose_bounds,
    compute_joint_limits,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import compute_step_limits
from climbplan.climb.transition.separating_planes import (
    LinkPairs,
    compute_separating_faces,
    compute_separating_planes,
    find_close_links,
)
from climbplan.climb.transition.stance_forces import SearchTables, solve_stance_forces
from climbplan.program.staged_program import StagedProgram
from climbplan.reformulations.nlp_form import Bounds
from climbplan.robots.kinematics import to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.terrain.surfaces import Region

JOINT_MARGIN = 2e-3  # [rad] from joint bounds, for motions between instants
MARGIN = 1e-3  # of friction and torque, as the force planner's pyramids are inscribed
_MAX_FORCE = 10.0  # of a limb, in units of the weight


@dataclass(frozen=True)
class MotionData:
    """The data of one solve."""

    parameters: dict[str, Array]
    start: Array
    bounds: Bounds


def build_shape(
    scene: TransitionScene, rounds: int, separate: bool = False, link_pairs: LinkPairs = ()
) -> MotionDimensions:
    """Build the shape of a scene's program.

    Args:
        scene: The scene.
        rounds: Number M of rounds.
        separate: Whether limbs are constrained to stay clear.
        link_pairs: Links of two limbs that are separated then.
    """
    robot = scene.robot
    num_capsules = robot.joint_count if robot.capsules is None else robot.capsules.joint.shape[1]
    return MotionDimensions(
        num_capsules=num_capsules if separate else 0,
        link_pairs=link_pairs if separate else (),
        rounds=rounds,
        kinematics=build_symbolic_limbs(scene.robot),
        solids=len(scene.terrain.solids),
        edges=max(len(s.b) for s in scene.terrain.surfaces if isinstance(s, Region)),
    )


def get_toes(tables: SearchTables, sequence: ContactSequence) -> Array:
    """Return the toes (M + 1, N, 3) of a sequence on its footholds [m]."""
    limb = np.arange(tables.scene.robot.limb_count)
    return tables.footholds.toe[limb, np.array(sequence.states)]


def find_free_footholds(sequence: ContactSequence) -> BoolArray:
    """Find toes (M + 1, N) on intermediate footholds, whose places are variables."""
    states = np.array(sequence.states)
    return (states != START) & (states != GOAL)


def compute_search_forces(tables: SearchTables, sequence: ContactSequence) -> tuple[Array, Array]:
    """Compute forces (M, N, 3) by the weight, and torque use (M,), at the poses of the search."""
    stances = np.array(
        [get_stance(a, b) for a, b in zip(sequence.states, sequence.states[1:], strict=False)]
    )
    solution = solve_stance_forces(tables, stances, np.array(sequence.poses)[:-1])
    return solution.force / tables.scene.robot.weight, solution.torque_use


@dataclass(frozen=True)
class ForceMargins:
    """Bounds on forces and commands, by the spec's bounds and a fraction of its margins."""

    pressure: float  # [weight]
    reserve: float  # of it, that may go missing before a toe slips [weight]
    least_depth: float | None  # of commands, to first order [m]; None: not asked
    depth: float | None  # of commands, where free toes would be [m]; None: not asked
    torque: float  # part of its limit that every motor has left


def compute_force_margins(scene: TransitionScene, margin_fraction: float) -> ForceMargins:
    """Compute the spec's bounds with a fraction of its margins."""
    spec, spec_margins = scene.spec, scene.spec.margins
    weight = scene.robot.weight
    pressure = max(spec.search.min_load, spec.force.min_normal_force / weight)
    depth = spec.force.min_penetration
    if not spec_margins.asked or margin_fraction <= 0:
        return ForceMargins(pressure, 0.0, depth, None, 0.0)
    return ForceMargins(
        max(pressure, margin_fraction * spec_margins.normal_force),
        margin_fraction * spec_margins.friction,
        depth,
        margin_fraction * spec_margins.depth,
        margin_fraction * spec_margins.torque,
    )


def build_motion_data(
    tables: SearchTables,
    formulation: StagedProgram,
    sequence: ContactSequence,
    safety_torque: float,
    *,
    margin_fraction: float = 0.0,
    separate: bool = False,
    link_pairs: LinkPairs = (),
    joint_margin: float = JOINT_MARGIN,
) -> MotionData:
    """Build parameters, start and bounds for a sequence.

    Args:
        tables: Footholds and poses of the search.
        formulation: The motion program.
        sequence: The contact sequence.
        safety_torque: Smallest S_tau.
        margin_fraction: Fraction of the spec's margins.
        separate: Whether limbs are constrained to stay clear.
        link_pairs: Links of two limbs that are separated then.
        joint_margin: Distance of angles and commands from their bounds [rad].
    """
    margins = compute_force_margins(tables.scene, margin_fraction)
    scene = tables.scene
    poses = np.array(sequence.poses)[:-1]
    pose = np.concatenate([tables.poses.com[poses], tables.poses.rpy[poses]], axis=1)
    force, torque_use = compute_search_forces(tables, sequence)
    torque_use = np.where(np.isfinite(torque_use), torque_use, 1 / safety_torque)[:, None]
    pose_lower, pose_upper = _compute_pose_bounds(scene, len(poses))
    m = len(poses)
    toe = get_toes(tables, sequence)[1:].reshape(m, -1)
    toe_freedom = np.where(np.repeat(find_free_footholds(sequence)[1:], 3, axis=1), np.inf, 0.0)
    max_force = np.repeat(np.where(sequence.moves, 0.0, _MAX_FORCE), 3, axis=1)
    max_s = np.array([(1 - MARGIN) * min(1 / safety_torque, 1 - margins.torque)])
    start = {"pose": pose, "toe": toe, "force": force.reshape(m, -1), "s": torque_use}
    lower = {"pose": pose_lower, "toe": toe - toe_freedom, "force": -max_force, "s": np.zeros(1)}
    upper = {"pose": pose_upper, "toe": toe + toe_freedom, "force": max_force, "s": max_s}
    toes, limbs = _compute_toe_points(tables, sequence), build_symbolic_limbs(scene.robot)
    at_toes = limbs.at_toes(scene.robot, toes)
    checked = np.swapaxes(_find_checked_toes(scene, sequence), 1, 2)[..., None]  # (M, POINTS, N, 1)
    for name in limbs.variable_shapes:
        values = at_toes[name]
        limits: tuple[Array | float, Array | float] = (-np.inf, np.inf)
        if name == "angles":
            limits = compute_joint_limits(scene.robot, joint_margin)
        # Without constraints that tie them to toes they are fixed at their start
        start[name], lower[name], upper[name] = (
            v.reshape(m, -1) for v in (values, *(np.where(checked, end, values) for end in limits))
        )
    toe_parameters = {name: at_toes[name] for name in limbs.parameter_shapes}
    if separate:
        points = toes, checked[..., 0]
        toe_parameters |= compute_separating_faces(scene, pose[:, :3], pose[:, 3:], *points)
        toe_parameters |= compute_separating_planes(scene, *points, sequence.moves, link_pairs)
    rows = _build_row_bounds(scene, formulation, sequence, margins, joint_margin)
    bounds = Bounds(formulation.point(lower), formulation.point(upper), *rows)
    parameters = _build_parameters(tables, sequence, margins, toe_parameters)
    return MotionData(parameters, formulation.point(start), bounds)


def _compute_pose_bounds(scene: TransitionScene, count: int) -> tuple[Array, Array]:
    """Return lower and upper bounds (count, 6) of body poses, first of the pose at the start."""
    max_rotation = np.full(3, np.deg2rad(scene.spec.posture.rotation_limit_deg))
    body = np.stack([scene.start.com, scene.goal.com])
    span = scene.spec.posture.steps.com_max
    lower, upper = np.empty((count, 6)), np.empty((count, 6))
    lower[0], upper[0] = compute_first_pose_bounds(scene)
    lower[1:] = np.concatenate([body.min(axis=0) - span, -max_rotation])
    upper[1:] = np.concatenate([body.max(axis=0) + span, max_rotation])
    return lower, upper


def _find_free_poses(scene: TransitionScene, rounds: int) -> BoolArray:
    """Find rounds (M, 1) whose pose is variable: all but the first, unless that may be shifted."""
    return ((np.arange(rounds) > 0) | (scene.spec.posture.steps.com_shift_max > 0))[:, None]


def _find_checked_toes(scene: TransitionScene, sequence: ContactSequence) -> BoolArray:
    """Find toes (M, N, POINTS) that must be in reach: old, new, hovering over old, over new."""
    open_toes, moves = find_free_footholds(sequence), sequence.moves
    is_free = _find_free_poses(scene, len(moves))
    old, new = is_free | open_toes[:-1], moves & (is_free | open_toes[1:])
    return np.stack([old, new, moves & old, new], axis=-1)


def find_links_to_separate(
    tables: SearchTables, sequence: ContactSequence, colliding_motion: Rounds | None = None
) -> LinkPairs:
    """Find links of two limbs that come close on the path of the search, or in another motion."""
    moves = sequence.moves
    pairs = find_close_links(tables.scene, _compute_toe_points(tables, sequence), moves)
    if colliding_motion is not None:
        colliding_pairs = find_close_links(
            tables.scene, _compute_toe_points(tables, sequence, colliding_motion), moves
        )
        pairs = tuple(sorted({*pairs, *colliding_pairs}))
    return pairs


def _compute_toe_points(
    tables: SearchTables, sequence: ContactSequence, rounds: Rounds | None = None
) -> Array:
    """Compute toes (M, POINTS, N, 3) old, new and hovering over both, body frame [m].

    rounds: a motion of the sequence; None takes the path of the search.
    """
    scene, footholds = tables.scene, tables.footholds
    limb, states = np.arange(scene.robot.limb_count), np.array(sequence.states)
    poses = np.array(sequence.poses)[:-1]
    states_at_ends = (states[:-1], states[1:])
    if rounds is None:
        com, rpy = tables.poses.com[poses], tables.poses.rpy[poses]
        points = [footholds.toe[limb, state] for state in states_at_ends]
    else:
        com, rpy = rounds.com[:-1], rounds.rpy[:-1]
        points = [rounds.toes[:-1], rounds.toes[1:]]
    swing_clearance = scene.spec.trajectory.swing_clearance
    points += [
        p + swing_clearance * footholds.normal[limb, s]
        for p, s in zip(points, states_at_ends, strict=True)
    ]
    return np.stack([to_body(com, rpy, p) for p in points], axis=1)


def _build_parameters(
    tables: SearchTables,
    sequence: ContactSequence,
    margins: ForceMargins,
    toe_parameters: dict[str, Array],
) -> dict[str, Array]:
    """Build the parameters; toe_parameters: those of limbs at their toes."""
    scene, robot, footholds = tables.scene, tables.scene.robot, tables.footholds
    limb, states = np.arange(robot.limb_count), np.array(sequence.states)
    old, new = states[:-1], states[1:]  # (M, N)
    poses = np.array(sequence.poses)[:-1]
    com, rpy = tables.poses.com[poses], tables.poses.rpy[poses]
    shape = build_shape(scene, len(old))
    mu = footholds.mu[limb, old] / scene.spec.force.safety_friction * (1 - MARGIN)
    region = footholds.region[limb, new]
    edges = np.zeros((*region.shape, shape.edges, 3))
    edge_offsets, plane = np.ones((*region.shape, shape.edges)), np.empty(region.shape)
    for index in np.unique(region):
        surface, uses_surface = scene.terrain.surfaces[index], region == index
        if not isinstance(surface, Region):
            raise TypeError("transitions stand on flat surfaces")
        edges[uses_surface, : len(surface.b)], edge_offsets[uses_surface, : len(surface.b)] = (
            surface.A,
            surface.b,
        )
        plane[uses_surface] = surface.offset

    hull = com[:, None] + robot.body_hull @ np.swapaxes(rotation_world_body(rpy), -1, -2)
    faces, offsets = np.empty((len(com), shape.solids, 3)), np.empty((len(com), shape.solids))
    for s, solid in enumerate(scene.terrain.solids):
        best = (hull @ solid.A.T - solid.b).min(axis=1).argmax(axis=1)
        faces[:, s], offsets[:, s] = solid.A[best], solid.b[best]
    every_round = {
        "normal_old": footholds.normal[limb, old],
        "normal_new": footholds.normal[limb, new],
        "mu": np.where(old == new, mu, 0.0),
        **toe_parameters,
        "edge_row": edges,
        "edge_end": edge_offsets,
        "plane": plane,
        "face": faces,
        "face_end": offsets,
        "load": compute_load_wrench(scene.spec, robot, rpy) / robot.weight,
    }
    return {
        **build_robot_parameters(scene, footholds.toe[limb, states[0]]),
        **{name: value.reshape(len(old), -1).T for name, value in every_round.items()},
        "hull": robot.body_hull.reshape(-1, 1),
        "lift": np.array([[scene.spec.trajectory.swing_clearance]]),
        "least_load": np.array([[margins.pressure]]),
        "least_depth": np.array([[margins.least_depth or 0.0]]),
        "margin_depth": np.array([[margins.depth or 0.0]]),
        "reserve": np.array([[margins.reserve]]),
    }


def _build_row_bounds(
    scene: TransitionScene,
    formulation: StagedProgram,
    sequence: ContactSequence,
    margins: ForceMargins,
    joint_margin: float,
) -> tuple[Array, Array]:
    """Build the bounds of constraints; those of fixed quantities are infinite.

    Masks are (M, rows of a round).
    """
    robot, spec = scene.robot, scene.spec
    open_toes, moves = find_free_footholds(sequence), sequence.moves
    was_open, is_open = open_toes[:-1], open_toes[1:]
    m, n = moves.shape
    is_free = _find_free_poses(scene, m)
    stands, is_checked = ~moves, is_free | (np.arange(m) + 1 < m)[:, None]
    check, sizes = _find_checked_toes(scene, sequence).reshape(m, POINTS * n), formulation.sizes()
    joints = robot.joint_count
    steps = spec.posture.steps
    max_rotation = np.deg2rad(steps.rotation_max_deg)
    row_bounds = {
        "force.command": build_joint_row_bounds(robot, joint_margin),
        "steps.toe": (-np.inf, (compute_step_limits(scene) - 1e-6) ** 2),
        "steps.com": (-np.inf, (steps.com_max - 1e-6) ** 2),
        "steps.rotation": (-max_rotation, max_rotation),
        "body.clearance": (spec.posture.body_clearance + 1e-6, np.inf),
    }
    if "transition.joints" in sizes:
        row_bounds["transition.joints"] = build_joint_row_bounds(robot, joint_margin, POINTS)
    placed = moves & is_open
    ties = [name for name in TIES if name in sizes]
    holds = {
        **{name: np.repeat(check, sizes[name] // check.size, axis=1) for name in ties},
        "force.friction": stands,
        "force.contact": stands,
        "force.torque": np.repeat(stands, 2 * joints, axis=1),
        "force.penetration": stands & (margins.least_depth is not None),
        "force.inside": stands & (margins.depth is not None),
        "force.command": np.repeat(stands, joints, axis=1),
        "foothold.inside": np.repeat(placed, sizes["foothold.inside"] // (m * n), axis=1),
        "steps.toe": moves & (was_open | is_open),
        "foothold.stays": np.repeat(stands & is_open, 3, axis=1),
        "foothold.plane": placed,
        "steps.com": is_checked,
        "steps.rotation": is_checked,
        "body.clearance": is_free,
    }
    return formulation.replace_row_bounds(row_bounds, holds)
