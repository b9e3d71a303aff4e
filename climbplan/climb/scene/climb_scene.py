"""The scene of a climb: robot, terrain, start and goal as arrays, with mistakes of the spec."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.scene.footing import add_goal_to_footing, build_footing
from climbplan.climb.scene.plausible_lengths import find_implausible_lengths
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import CONVEX_METHODS, ClimbSpec, PostureSpec
from climbplan.climb.schema.motion import MotionSpec
from climbplan.errors import SpecError, SpecMistake
from climbplan.mechanics.grip import Grippers, grippers_on
from climbplan.mechanics.gripper_model import load_model
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import (
    contact_points,
    sole_turns,
    solve_inverse_kinematics,
    to_body,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.task_robot import heading_as, standing_as, with_grip_limit, with_stance
from climbplan.schema.robots.source import AnyRobot
from climbplan.terrain.model import Terrain, build_terrain
from climbplan.terrain.nearest import bounds_of, nearest_region
from climbplan.terrain.soles import beyond, fits
from climbplan.terrain.surfaces import Region, Surface

if TYPE_CHECKING:
    from climbplan.climb.schema.transition_loading import LoadedTransition

_EDGE_TOLERANCE = 1e-6  # [m] beyond an edge that counts as none


def find_flat_foot_mistakes(
    spec: ClimbSpec, robot: Robot, terrain: Terrain
) -> Iterator[SpecMistake]:
    """Yield requirements of spec and terrain that flat feet cannot have; nothing for other feet."""
    sole = robot.sole
    if sole is None:
        return
    prefix = "flat feet are planned with"
    if terrain.is_curved:
        yield SpecMistake("terrain.tube", f"{prefix} flat surfaces alone")
    if spec.terrain.scan is not None:
        yield SpecMistake("terrain.scan", f"{prefix} stated surfaces alone, not scans")
    if spec.force.deflection_compensation != "compensated":
        yield SpecMistake(
            "force.deflection_compensation",
            f"{prefix} `compensated`: a body that sags would tilt them",
        )
    if spec.solver.method not in ("auto", *CONVEX_METHODS):
        methods = ", ".join(f"`{name}`" for name in CONVEX_METHODS)
        yield SpecMistake("solver.method", f"{prefix} the methods `auto`, {methods} alone")
    if terrain.is_curved:
        return
    fits_sole = np.array([fits(region, sole) for region in terrain.regions])
    for limb in np.flatnonzero(~(terrain.allowed & fits_sole).any(axis=1)):
        size = f"{1e3 * sole.length:.0f} x {1e3 * sole.width:.0f} mm"
        name = robot.limb_names[limb]
        yield SpecMistake("terrain", f"no surface that {name} may use has room for its {size} sole")


def find_overhanging_soles(
    key: str, robot: Robot, terrain: Terrain, toes: Array, region: IntArray
) -> Iterator[SpecMistake]:
    """Yield soles at toes (N, 3) that reach beyond their surfaces (N,)."""
    if robot.sole is None or terrain.is_curved:
        return
    for limb, name in enumerate(robot.limb_names):
        surface = terrain.regions[region[limb]]
        excess = beyond(surface, robot.sole, toes[limb])
        if excess > _EDGE_TOLERANCE:
            yield SpecMistake(
                f"{key}.toes.{name}",
                f"expected the whole sole of {name} on {surface.name!r}; it reaches "
                f"{1e3 * excess:.1f} mm beyond its edge",
            )


Loaded = TypeVar("Loaded", "LoadedClimb", "LoadedTransition")

_log = logging.getLogger(__name__)

REACH_MARGIN = 0.05  # share of its reach that a limb keeps for toes that a spec leaves open
# Points beside a nominal stance that are looked at where joint bounds forbid it
_SEARCH_RADII = np.arange(0.01, 0.36, 0.01)  # [m]
_SEARCH_ANGLES = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)  # [rad]
_JOINT_MARGIN = np.deg2rad(2.0)  # that joints keep there, in their units
_MIN_FRICTION_RATIO = 0.1  # of the largest friction coefficient: ground with less is none to choose
_MIN_SHIFT = 1e-9  # [m] a toe that would move by less stays
SURFACE_TOLERANCE = 1e-3  # [m] stated toes must lie this close to a surface; they are put on it


@dataclass(frozen=True)
class ClimbStance:
    """One posture: body pose and toes on surfaces."""

    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]
    toes: Array  # (N, 3) [m]
    region: IntArray  # (N,)


@dataclass(frozen=True)
class MotionScene:
    """The data that stages shared by climbs and transitions start from."""

    spec: MotionSpec
    robot: Robot
    terrain: Terrain
    start: ClimbStance
    goal: ClimbStance
    grippers: Grippers | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class ClimbScene(MotionScene):
    """The data that the climb planner starts from."""

    spec: ClimbSpec
    gait: tuple[int, ...]  # limbs in the order in which they move
    # Regions of the terrain without strips along edges where toes are not to stand; () for none
    footing: tuple[Region, ...] = field(default=(), kw_only=True)
    # (M, N, R) surfaces that limb i may use in round j; None for those of the terrain in all rounds
    by_round: BoolArray | None = field(default=None, kw_only=True)

    @property
    def alternatives(self) -> list[list[IntArray]]:
        """Return the indices of the surfaces that limb i may use at the end of round j, [j][i]."""
        m, allowed = self.spec.task.round_count, self.terrain.allowed
        rounds = [allowed] * m if self.by_round is None else list(self.by_round)
        return [
            [np.flatnonzero(limb_surfaces).astype(np.int64) for limb_surfaces in round_surfaces]
            for round_surfaces in rounds
        ]

    @property
    def standing(self) -> tuple[Region, ...]:
        """Return where toes are planned to stand, one region for each of the terrain's."""
        return self.footing or self.terrain.regions


def build_stance(
    posture: PostureSpec,
    key: str,
    robot: Robot,
    terrain: Terrain,
    mistakes: list[SpecMistake],
    lift: float = 0.0,
) -> ClimbStance:
    """Return stated toes, or the surface points nearest to the limbs' nominal stances.

    Where joint bounds do not let a limb stand there, or lift its toe, the nearest feasible point is
    taken.

    Args:
        posture: The posture of the spec.
        key: Its key, for messages.
        robot: The robot.
        terrain: The terrain.
        mistakes: List to which stated toes off their surfaces are appended.
        lift: Height [m] to which toes have to be lifted.
    """
    com, rpy = np.array(posture.com, float), np.deg2rad(posture.rpy_deg)
    nominal = com + robot.stance_body @ rotation_world_body(rpy).T
    shoulders = com + robot.shoulder_body @ rotation_world_body(rpy).T
    toes, region = np.empty_like(nominal), np.empty(robot.limb_count, np.int64)
    for limb, name in enumerate(robot.limb_names):
        point = np.array(posture.toes.get(name, nominal[limb]), float)
        if name in posture.toes:
            point, region[limb], distance = _place_stated_toe(robot, terrain, limb, point)
        else:
            region[limb], distance = terrain.nearest_surface(limb, point), 0.0
        surface = terrain.surfaces[region[limb]]
        toes[limb] = surface.project(point)
        if name not in posture.toes:
            toes[limb] = _move_within_reach(robot.reach, shoulders[limb], toes[limb], surface)
            toes[limb] = move_within_joint_bounds(
                robot, limb, (com, rpy), toes[limb], surface, lift
            )
        if distance > SURFACE_TOLERANCE:
            mistakes.append(
                SpecMistake(
                    f"{key}.toes.{name}",
                    f"expected a point on a contact region {name} may use; "
                    f"it is {1e3 * distance:.2f} mm off {surface.name!r}",
                )
            )
    return ClimbStance(com, rpy, toes, region)


def _place_stated_toe(
    robot: Robot, terrain: Terrain, limb: int, point: Array
) -> tuple[Array, int, float]:
    """Return the toe of a limb in contact at a stated point (3,), its surface and the distance to
    it.

    For feet of finite size the point is the contact point, for grippers the wrist's centre.
    """
    contact_terrain = terrain if robot.foot is None else terrain.offset_surfaces(-robot.standoff)
    region = contact_terrain.nearest_surface(limb, point)
    distance = contact_terrain.surfaces[region].distance(point)
    if robot.foot is None:
        return point, region, distance
    normal = contact_terrain.surfaces[region].normal_at(point)
    return point + robot.standoff * normal, region, distance


def compute_stated_toes(robot: Robot, terrain: Terrain, toes: Array, region: IntArray) -> Array:
    """Return toes (N, 3) on surfaces (N,) as specs state them: contact points for feet of finite
    size.
    """
    return contact_points(robot, toes, compute_toe_normals(terrain, toes, region))


def compute_toe_normals(terrain: Terrain, toes: Array, region: IntArray) -> Array:
    """Return the unit normals (N, 3) of surfaces (N,) at toes (N, 3)."""
    where = zip(toes, region, strict=True)
    return np.array([terrain.surfaces[int(r)].normal_at(toe) for toe, r in where])


def _move_onto_footing(
    stance: ClimbStance,
    posture: PostureSpec,
    robot: Robot,
    terrain: Terrain,
    trimmed_regions: tuple[Region, ...],
    lift: float,
) -> ClimbStance:
    """Return the stance with unstated toes moved off edges and onto surfaces of sufficient
    friction.

    trimmed_regions: Regions without strips along edges. A toe that cannot be improved stays.
    """
    regions = trimmed_regions or terrain.regions
    if not regions:
        return stance
    bounds = bounds_of(regions)
    toes, region = stance.toes.copy(), stance.region.copy()
    shoulders = stance.com + robot.shoulder_body @ rotation_world_body(stance.rpy).T
    for limb, name in enumerate(robot.limb_names):
        if name in posture.toes or regions[region[limb]].hold is not None:
            continue
        candidates = np.flatnonzero(terrain.allowed[limb])
        max_friction = max(regions[r].friction for r in candidates)
        candidates = candidates[
            [regions[r].friction >= _MIN_FRICTION_RATIO * max_friction for r in candidates]
        ]
        if robot.sole is not None:
            candidates = candidates[[fits(terrain.regions[r], robot.sole) for r in candidates]]
        nearest = nearest_region(regions, bounds, candidates, toes[limb])
        surface = regions[nearest]
        point = surface.project(toes[limb])
        shift = np.linalg.norm(point - toes[limb])
        if shift < _MIN_SHIFT or np.linalg.norm(point - shoulders[limb]) > robot.reach:
            continue
        body = (stance.com, stance.rpy)
        if np.array_equal(move_within_joint_bounds(robot, limb, body, point, surface, lift), point):
            toes[limb], region[limb] = point, nearest
    return replace(stance, toes=toes, region=region)


def _move_within_reach(reach: float, shoulder: Array, toe: Array, surface: Surface) -> Array:
    """Return the toe, moved on its surface towards the shoulder until it is within reach."""
    reach *= 1.0 - REACH_MARGIN
    if np.linalg.norm(toe - shoulder) <= reach:
        return toe
    nearest = surface.project(shoulder)
    reached, unreached = 1.0, 0.0  # shares of the way to the nearest point: in reach, out of reach
    for _ in range(40):
        fraction = (reached + unreached) / 2
        point = surface.project(toe + fraction * (nearest - toe))
        if np.linalg.norm(point - shoulder) <= reach:
            reached = fraction
        else:
            unreached = fraction
    return surface.project(toe + reached * (nearest - toe))


def move_within_joint_bounds(
    robot: Robot, limb: int, body: tuple[Array, Array], toe: Array, surface: Surface, lift: float
) -> Array:
    """Return the toe, moved on its surface to the nearest point where joint bounds let the limb
    stand.

    The toe is returned unchanged where the limb can stand there, or where no nearby point is
    better.

    Args:
        robot: The robot.
        limb: Index of the limb.
        body: Body origin (3,) [m] and roll, pitch, yaw (3,) [rad].
        toe: (3,) position of the toe [m].
        surface: The surface that the toe is on.
        lift: Height [m] along the normal that has to be reached, too.
    """
    one_limb = robot.one_limb(limb)

    def can_stand(points: Array, margin: float) -> BoolArray:
        """(P,) whether toe and lifted toe are reached with joints that far inside their bounds."""
        joint_margin = margin * one_limb.joint_unit
        normals = np.array([surface.normal_at(point) for point in points])
        lifted_points = points + lift * normals
        sole_rotations = sole_turns(one_limb, body[1], normals[:, None])
        valid = [
            solve_inverse_kinematics(
                one_limb, to_body(*body, toe_points[:, None]), sole_rotations, joint_margin
            ).valid[:, 0]
            for toe_points in (points, lifted_points)
        ]
        return np.asarray(valid[0] & valid[1])

    if can_stand(toe[None], 0.0)[0]:
        return toe
    normal = surface.normal_at(toe)
    tangent_1 = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    tangent_1 /= np.linalg.norm(tangent_1)
    tangent_2 = np.cross(normal, tangent_1)
    radius, angle = (x.ravel() for x in np.meshgrid(_SEARCH_RADII, _SEARCH_ANGLES, indexing="ij"))
    directions = np.cos(angle)[:, None] * tangent_1 + np.sin(angle)[:, None] * tangent_2
    points = np.array(
        [surface.project(toe + r * v) for r, v in zip(radius, directions, strict=True)]
    )
    shoulder = body[0] + rotation_world_body(body[1]) @ robot.shoulder_body[limb]
    distance, is_reached = (
        np.linalg.norm(points - shoulder, axis=1),
        can_stand(points, _JOINT_MARGIN),
    )
    for reserve in (REACH_MARGIN, 0.0):  # rather near the end of its reach than nowhere
        suitable = np.flatnonzero(is_reached & (distance <= robot.reach * (1.0 - reserve)))
        if len(suitable):
            closest = suitable[np.argmin(np.linalg.norm(points[suitable] - toe, axis=1))]
            return np.asarray(points[closest])
    return toe


def compute_load_wrench(spec: MotionSpec, robot: Robot, rpy: Array) -> Array:
    """Return payload weight and external load as force and moment (..., 6) about the body origin.

    The result is in the world frame [N, N m]; rpy is (..., 3) [rad].
    """
    payload, external = spec.task.payload, spec.task.external_wrench
    weight = np.array([0.0, 0.0, -payload.mass * robot.gravity])
    lever_arm = rotation_world_body(rpy) @ np.array(payload.offset, float)
    moment = np.cross(lever_arm, weight) + np.array(external.moment, float)
    force = np.broadcast_to(weight + np.array(external.force, float), moment.shape)
    return np.concatenate([force, moment], axis=-1)


def warn_of_reversed_regions(terrain: Terrain, stances: tuple[ClimbStance, ...]) -> None:
    """Warn of regions that face away from the robot at start and goal.

    A region supports what pushes against its normal. If its corners run clockwise, seen from the
    robot, toes would have to stand on its back.
    """
    for k, surface in enumerate(terrain.surfaces):
        if not isinstance(surface, Region) or not terrain.allowed[:, k].any():
            continue
        if terrain.scan is not None and surface.name.startswith("scan "):
            continue
        if all(float(surface.normal @ s.com) - surface.offset < 0 for s in stances):
            facing = ", ".join(f"{v:.3g}" for v in surface.normal)
            _log.warning(
                "region %r looks away from the robot at its start and goal (normal %s): forces of "
                "toes there would pull; seen from the robot its corners run clockwise, turn their "
                "order round, or its normal",
                surface.name,
                facing,
            )


def apply_scan(loaded: Loaded) -> Loaded:
    """Return the spec with regions and free space of its scan, if it has one."""
    if loaded.spec.terrain.scan is None:
        return loaded
    from climbplan.climb.scene.scanning import (
        fit_scan,  # compiled functions, which others do without
    )

    return fit_scan(loaded)


def add_raw_surface(terrain: Terrain, spec: MotionSpec, robot: Robot, directory: Path) -> Terrain:
    """Return the terrain with the raw surface of its scan near the path, if it has one."""
    if spec.terrain.scan is None:
        return terrain
    from climbplan.climb.scene.scanning import load_raw_surface

    return replace(terrain, scan=load_raw_surface(spec, directory, robot))


def _build_grippers(
    spec: ClimbSpec, robot_spec: AnyRobot, robot: Robot, terrain: Terrain, directory: Path
) -> Grippers | None:
    """Return the grippers of a robot on the terrain's holds; None if it has none."""
    if robot.gripper is None or robot_spec.gripper is None:
        return None
    model = load_model(spec.gripper.model or robot_spec.gripper.model, directory)
    return grippers_on(robot.gripper, model, spec.gripper.risk, terrain.surfaces)


def build_scene(
    spec: ClimbSpec, robot_spec: AnyRobot, source: str = "spec", directory: Path | None = None
) -> ClimbScene:
    """Return the scene of a validated spec.

    Args:
        spec: The spec.
        robot_spec: The robot as its spec states it.
        source: Name of the spec, for messages.
        directory: Where a gripper model given by path is looked up.

    Raises:
        SpecError: Toes are off their surfaces.
        UsageError: The terrain is malformed, or the gripper model cannot be used.
    """
    if spec.task.start.plan is not None:
        raise ValueError("the start is still in its plan file")
    robot = with_stance(build_robot(robot_spec), spec.task.stance)
    robot = with_grip_limit(robot, spec.gripper.max_force)
    robot = heading_as(robot, np.deg2rad(spec.task.start.rpy_deg))
    terrain = build_terrain(spec.terrain, robot)
    terrain = add_raw_surface(terrain, spec, robot, directory or Path())
    mistakes = [
        *find_implausible_lengths(spec, robot, terrain),
        *find_flat_foot_mistakes(spec, robot, terrain),
    ]
    if mistakes:
        raise SpecError(source, mistakes)
    lift = spec.trajectory.swing_clearance
    start = build_stance(spec.task.start, "task.start", robot, terrain, mistakes, lift)
    edge = spec.margins.edge
    trimmed_regions = build_footing(terrain, edge, robot.foot)
    trims_edges = edge > 0 or robot.foot is not None  # than points, feet do not stand everywhere
    if trims_edges:
        start = _move_onto_footing(start, spec.task.start, robot, terrain, trimmed_regions, lift)
    # Where the toes stand at the start is the stance of the whole climb, unless the task says so.
    robot = standing_as(robot, start.com, start.rpy, start.toes, spec.task.stance)
    goal = build_stance(spec.task.goal, "task.goal", robot, terrain, mistakes, lift)
    if trims_edges:
        goal = _move_onto_footing(goal, spec.task.goal, robot, terrain, trimmed_regions, lift)
    for key, stance in (("task.start", start), ("task.goal", goal)):
        mistakes += find_overhanging_soles(key, robot, terrain, stance.toes, stance.region)
    if mistakes:
        raise SpecError(source, mistakes)
    warn_of_reversed_regions(terrain, (start, goal))
    order = spec.task.gait or robot.limb_names
    return ClimbScene(
        spec=spec,
        robot=robot,
        terrain=terrain,
        start=start,
        goal=goal,
        gait=tuple(robot.limb_names.index(name) for name in order),
        grippers=_build_grippers(spec, robot_spec, robot, terrain, directory or Path()),
        footing=add_goal_to_footing(
            terrain, edge, trimmed_regions, (goal.toes, goal.region), robot.foot
        ),
    )
