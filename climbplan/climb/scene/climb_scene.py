"""The scene of a climb: robot, terrain, start and goal in numbers, or what of them cannot be."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.scene.footing import footing, footing_with_goal
from climbplan.climb.scene.plausible_lengths import implausible_lengths
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import CONVEX_METHODS, ClimbSpec, PostureSpec
from climbplan.climb.schema.motion import MotionSpec
from climbplan.errors import SpecError, SpecMistake
from climbplan.mechanics.grip import Grippers, grippers_on
from climbplan.mechanics.gripper_model import load_model
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import contact_points, inverse, sole_turns, to_body
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

_OVER = 1e-6  # [m] beyond an edge that counts as none


def flat_foot_mistakes(spec: ClimbSpec, robot: Robot, terrain: Terrain) -> Iterator[SpecMistake]:
    """What the spec and its terrain cannot have of a robot with flat feet; nothing for others."""
    sole = robot.sole
    if sole is None:
        return
    what = "flat feet are planned with"
    if terrain.is_curved:
        yield SpecMistake("terrain.tube", f"{what} flat surfaces alone")
    if spec.terrain.scan is not None:
        yield SpecMistake("terrain.scan", f"{what} stated surfaces alone, not scans")
    if spec.force.deflection_compensation != "compensated":
        yield SpecMistake("force.deflection_compensation", f"{what} `compensated`: a body that sags would tilt them")
    if spec.solver.method not in ("auto", *CONVEX_METHODS):
        known = ", ".join(f"`{name}`" for name in CONVEX_METHODS)
        yield SpecMistake("solver.method", f"{what} the methods `auto`, {known} alone")
    if terrain.is_curved:
        return
    room = np.array([fits(region, sole) for region in terrain.regions])
    for limb in np.flatnonzero(~(terrain.allowed & room).any(axis=1)):
        size = f"{1e3 * sole.length:.0f} x {1e3 * sole.width:.0f} mm"
        name = robot.limb_names[limb]
        yield SpecMistake("terrain", f"no surface that {name} may use has room for its {size} sole")


def overhanging(
    key: str, robot: Robot, terrain: Terrain, toes: Array, region: IntArray
) -> Iterator[SpecMistake]:
    """Soles about toes (N, 3) that reach beyond their surfaces (N,)."""
    if robot.sole is None or terrain.is_curved:
        return
    for limb, name in enumerate(robot.limb_names):
        surface = terrain.regions[region[limb]]
        over = beyond(surface, robot.sole, toes[limb])
        if over > _OVER:
            yield SpecMistake(
                f"{key}.toes.{name}",
                f"expected the whole sole of {name} on {surface.name!r}; it reaches "
                f"{1e3 * over:.1f} mm beyond its edge",
            )


Loaded = TypeVar("Loaded", "LoadedClimb", "LoadedTransition")

_log = logging.getLogger(__name__)

REACH_RESERVE = 0.05  # share of its reach that a limb keeps for toes that a spec leaves open
# Points beside a nominal stance that are looked at where joint bounds forbid it
_RINGS = np.arange(0.01, 0.36, 0.01)  # [m]
_TURNS = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)  # [rad]
_JOINT_RESERVE = np.deg2rad(2.0)  # that joints keep there, in their units
_HOLDS = 0.1  # of the largest friction coefficient: ground with less is none to choose
_MOVED = 1e-9  # [m] a toe that would move by less stays
ON_SURFACE = 1e-3  # [m] stated toes must lie this close to a surface; they are put on it


@dataclass(frozen=True)
class Stance:
    """One posture: body pose and toes on surfaces."""

    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]
    toes: Array  # (N, 3) [m]
    region: IntArray  # (N,)


@dataclass(frozen=True)
class MotionScene:
    """All numbers that stages shared by climbs and transitions start from."""

    spec: MotionSpec
    robot: Robot
    terrain: Terrain
    start: Stance
    goal: Stance
    grippers: Grippers | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class ClimbScene(MotionScene):
    """All numbers the planner starts from."""

    spec: ClimbSpec
    gait: tuple[int, ...]  # limbs in the order in which they move
    # Regions of the terrain without strips along edges where toes are not to stand; () for none
    footing: tuple[Region, ...] = field(default=(), kw_only=True)
    # (M, N, R) surfaces that limb i may use in round j; None for those of the terrain in all rounds
    by_round: BoolArray | None = field(default=None, kw_only=True)

    @property
    def alternatives(self) -> list[list[IntArray]]:
        """Numbers of the surfaces that limb i may use at the end of round j, [j][i]."""
        m, allowed = self.spec.task.round_count, self.terrain.allowed
        rounds = [allowed] * m if self.by_round is None else list(self.by_round)
        return [[np.flatnonzero(own).astype(np.int64) for own in each] for each in rounds]

    @property
    def standing(self) -> tuple[Region, ...]:
        """Where toes are planned to stand, one region for each of the terrain's."""
        return self.footing or self.terrain.regions


def stance_of(
    posture: PostureSpec,
    key: str,
    robot: Robot,
    terrain: Terrain,
    mistakes: list[SpecMistake],
    lift: float = 0.0,
) -> Stance:
    """Stated toes, or the surface points nearest to the limbs' nominal stances.

    Where joint bounds do not let a limb stand there, or lift its toe by `lift` [m], it is the
    nearest point beside it where they do.
    """
    com, rpy = np.array(posture.com, float), np.deg2rad(posture.rpy_deg)
    nominal = com + robot.stance_body @ rotation_world_body(rpy).T
    shoulders = com + robot.shoulder_body @ rotation_world_body(rpy).T
    toes, region = np.empty_like(nominal), np.empty(robot.limb_count, np.int64)
    for limb, name in enumerate(robot.limb_names):
        point = np.array(posture.toes.get(name, nominal[limb]), float)
        if name in posture.toes:
            point, region[limb], distance = _stated_toe(robot, terrain, limb, point)
        else:
            region[limb], distance = terrain.nearest_surface(limb, point), 0.0
        surface = terrain.surfaces[region[limb]]
        toes[limb] = surface.project(point)
        if name not in posture.toes:
            toes[limb] = _within_reach(robot.reach, shoulders[limb], toes[limb], surface)
            toes[limb] = within_joints(robot, limb, (com, rpy), toes[limb], surface, lift)
        if distance > ON_SURFACE:
            mistakes.append(
                SpecMistake(
                    f"{key}.toes.{name}",
                    f"expected a point on a contact region {name} may use; "
                    f"it is {1e3 * distance:.2f} mm off {surface.name!r}",
                )
            )
    return Stance(com, rpy, toes, region)


def _stated_toe(
    robot: Robot, terrain: Terrain, limb: int, point: Array
) -> tuple[Array, int, float]:
    """Where a limb's toe is that touches a stated point (3,); its surface, and how far that is off.

    Of feet of finite size the point is the one that touches, of grippers the wrist's centre.
    """
    there = terrain if robot.foot is None else terrain.offset_surfaces(-robot.standoff)
    region = there.nearest_surface(limb, point)
    distance = there.surfaces[region].distance(point)
    if robot.foot is None:
        return point, region, distance
    normal = there.surfaces[region].normal_at(point)
    return point + robot.standoff * normal, region, distance


def toes_as_stated(robot: Robot, terrain: Terrain, toes: Array, region: IntArray) -> Array:
    """Toes (N, 3) on surfaces (N,) as specs state them: of feet of finite size where they touch."""
    return contact_points(robot, toes, normals_under(terrain, toes, region))


def normals_under(terrain: Terrain, toes: Array, region: IntArray) -> Array:
    """Unit normals (N, 3) of surfaces (N,) at toes (N, 3)."""
    where = zip(toes, region, strict=True)
    return np.array([terrain.surfaces[int(r)].normal_at(toe) for toe, r in where])


def _on_footing(
    stance: Stance,
    posture: PostureSpec,
    robot: Robot,
    terrain: Terrain,
    plain: tuple[Region, ...],
    lift: float,
) -> Stance:
    """The stance with toes that the spec leaves open off edges, and on ground that holds.

    plain: regions without strips along edges. A toe keeps its place where it cannot stand any
    better.
    """
    regions = plain or terrain.regions
    if not regions:
        return stance
    bounds = bounds_of(regions)
    toes, region = stance.toes.copy(), stance.region.copy()
    shoulders = stance.com + robot.shoulder_body @ rotation_world_body(stance.rpy).T
    for limb, name in enumerate(robot.limb_names):
        if name in posture.toes or regions[region[limb]].hold is not None:
            continue
        usable = np.flatnonzero(terrain.allowed[limb])
        best = max(regions[r].friction for r in usable)
        usable = usable[[regions[r].friction >= _HOLDS * best for r in usable]]
        if robot.sole is not None:
            usable = usable[[fits(terrain.regions[r], robot.sole) for r in usable]]
        nearest = nearest_region(regions, bounds, usable, toes[limb])
        surface = regions[nearest]
        point = surface.project(toes[limb])
        far = np.linalg.norm(point - toes[limb])
        if far < _MOVED or np.linalg.norm(point - shoulders[limb]) > robot.reach:
            continue
        body = (stance.com, stance.rpy)
        if np.array_equal(within_joints(robot, limb, body, point, surface, lift), point):
            toes[limb], region[limb] = point, nearest
    return replace(stance, toes=toes, region=region)


def _within_reach(reach: float, shoulder: Array, toe: Array, surface: Surface) -> Array:
    """The toe, moved on its surface towards the shoulder until it is well within reach."""
    reach *= 1.0 - REACH_RESERVE
    if np.linalg.norm(toe - shoulder) <= reach:
        return toe
    nearest = surface.project(shoulder)
    near, far = 1.0, 0.0  # shares of the way to the nearest point: in reach, out of reach
    for _ in range(40):
        share = (near + far) / 2
        point = surface.project(toe + share * (nearest - toe))
        if np.linalg.norm(point - shoulder) <= reach:
            near = share
        else:
            far = share
    return surface.project(toe + near * (nearest - toe))


def within_joints(
    robot: Robot, limb: int, body: tuple[Array, Array], toe: Array, surface: Surface, lift: float
) -> Array:
    """The toe, moved on its surface to the nearest point where joint bounds let the limb stand.

    body: com and rpy; lift: [m] along the normal, also to be reached. The toe itself where it can
    stand there, or where no point nearby is any better.
    """
    alone = robot.one_limb(limb)

    def stands(points: Array, margin: float) -> BoolArray:
        """(P,) whether toe and lifted toe are reached with joints that far inside their bounds."""
        kept = margin * alone.joint_unit
        normals = np.array([surface.normal_at(point) for point in points])
        above = points + lift * normals
        turns = sole_turns(alone, body[1], normals[:, None])
        valid = [
            inverse(alone, to_body(*body, at[:, None]), turns, kept).valid[:, 0]
            for at in (points, above)
        ]
        return np.asarray(valid[0] & valid[1])

    if stands(toe[None], 0.0)[0]:
        return toe
    normal = surface.normal_at(toe)
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    along = np.cross(normal, across)
    radius, angle = (x.ravel() for x in np.meshgrid(_RINGS, _TURNS, indexing="ij"))
    beside = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along
    points = np.array([surface.project(toe + r * v) for r, v in zip(radius, beside, strict=True)])
    shoulder = body[0] + rotation_world_body(body[1]) @ robot.shoulder_body[limb]
    far, stood = np.linalg.norm(points - shoulder, axis=1), stands(points, _JOINT_RESERVE)
    for reserve in (REACH_RESERVE, 0.0):  # rather near the end of its reach than nowhere
        good = np.flatnonzero(stood & (far <= robot.reach * (1.0 - reserve)))
        if len(good):
            best = good[np.argmin(np.linalg.norm(points[good] - toe, axis=1))]
            return np.asarray(points[best])
    return toe


def load_wrench(spec: MotionSpec, robot: Robot, rpy: Array) -> Array:
    """Payload weight and external load as force and moment about the body origin.

    rpy: (..., 3) [rad]. Returns (..., 6) [N, N m], world frame.
    """
    payload, external = spec.task.payload, spec.task.external_wrench
    weight = np.array([0.0, 0.0, -payload.mass * robot.gravity])
    arm = rotation_world_body(rpy) @ np.array(payload.offset, float)
    moment = np.cross(arm, weight) + np.array(external.moment, float)
    force = np.broadcast_to(weight + np.array(external.force, float), moment.shape)
    return np.concatenate([force, moment], axis=-1)


def warn_of_backs(terrain: Terrain, stances: tuple[Stance, ...]) -> None:
    """Warn of regions that look away from the robot, at the start and at the goal.

    A region holds what pushes against its normal. Corners that run clockwise, seen from the robot,
    turn it away: toes would have to stand on its back.
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


def on_scan(loaded: Loaded) -> Loaded:
    """The spec with what is found in its scan, if it has one (`climbplan.climb.scene.scanning`)."""
    if loaded.spec.terrain.scan is None:
        return loaded
    from climbplan.climb.scene.scanning import (
        scanned,  # compiled functions, which others do without
    )

    return scanned(loaded)


def with_scan(terrain: Terrain, spec: MotionSpec, robot: Robot, directory: Path) -> Terrain:
    """The terrain with the raw surface of its scan near the way, if it has one."""
    if spec.terrain.scan is None:
        return terrain
    from climbplan.climb.scene.scanning import with_surface

    return replace(terrain, scan=with_surface(spec, directory, robot))


def _grippers(
    spec: ClimbSpec, robot_spec: AnyRobot, robot: Robot, terrain: Terrain, directory: Path
) -> Grippers | None:
    """What the robot's grippers hold on the terrain; None if it has none."""
    if robot.gripper is None or robot_spec.gripper is None:
        return None
    model = load_model(spec.gripper.model or robot_spec.gripper.model, directory)
    return grippers_on(robot.gripper, model, spec.gripper.risk, terrain.surfaces)


def build_scene(
    spec: ClimbSpec, robot_spec: AnyRobot, source: str = "spec", directory: Path | None = None
) -> ClimbScene:
    """Numbers of a validated spec; a gripper model given by path is looked up from `directory`.

    Raises SpecError for toes off their surfaces and UsageError for malformed terrain or a gripper
    model that cannot be used.
    """
    if spec.task.start.plan is not None:
        raise ValueError("the start is still in its plan file")
    robot = with_stance(build_robot(robot_spec), spec.task.stance)
    robot = with_grip_limit(robot, spec.gripper.max_force)
    robot = heading_as(robot, np.deg2rad(spec.task.start.rpy_deg))
    terrain = build_terrain(spec.terrain, robot)
    terrain = with_scan(terrain, spec, robot, directory or Path())
    mistakes = [
        *implausible_lengths(spec, robot, terrain),
        *flat_foot_mistakes(spec, robot, terrain),
    ]
    if mistakes:
        raise SpecError(source, mistakes)
    lift = spec.trajectory.swing_clearance
    start = stance_of(spec.task.start, "task.start", robot, terrain, mistakes, lift)
    edge = spec.margins.edge
    off_edges = footing(terrain, edge, robot.foot)
    closer = edge > 0 or robot.foot is not None  # than points, feet do not stand everywhere
    if closer:
        start = _on_footing(start, spec.task.start, robot, terrain, off_edges, lift)
    # Where the toes stand at the start is the stance of the whole climb, unless the task says so.
    robot = standing_as(robot, start.com, start.rpy, start.toes, spec.task.stance)
    goal = stance_of(spec.task.goal, "task.goal", robot, terrain, mistakes, lift)
    if closer:
        goal = _on_footing(goal, spec.task.goal, robot, terrain, off_edges, lift)
    for key, stance in (("task.start", start), ("task.goal", goal)):
        mistakes += overhanging(key, robot, terrain, stance.toes, stance.region)
    if mistakes:
        raise SpecError(source, mistakes)
    warn_of_backs(terrain, (start, goal))
    order = spec.task.gait or robot.limb_names
    return ClimbScene(
        spec=spec,
        robot=robot,
        terrain=terrain,
        start=start,
        goal=goal,
        gait=tuple(robot.limb_names.index(name) for name in order),
        grippers=_grippers(spec, robot_spec, robot, terrain, directory or Path()),
        footing=footing_with_goal(terrain, edge, off_edges, (goal.toes, goal.region), robot.foot),
    )
