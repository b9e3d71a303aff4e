"""Build the walking task of an MPC spec: body, terrain, start and reference.

Published methods and values are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely

from climbplan.arrays import Array
from climbplan.errors import SpecError, SpecMistake
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.urdf.walking_body import build_walking_body
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.plan.foot_centres import shift_to_foot_centres
from climbplan.walking.schema.loading import WalkingRobot
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkGoalSpec
from climbplan.walking.schema.terrain import (
    LevelRegionSpec,
    SteppingStonesSpec,
    WalkTerrainSpec,
    fit_slope,
)
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Goal,
    Reference,
    RigidBody,
    Start,
    WalkTask,
    Weights,
)


def sample_stones(spec: SteppingStonesSpec) -> tuple[list[str], Array, Array]:
    """Sample stepping stones on a grid with random angles and heights; some are missing.

    A stone has the same angle and height whatever other stones are missing. Names count missing
    stones, too.

    Args:
        spec: extents, pitch, size and ranges.

    Returns:
        Names, corners (S, 4, 2) counterclockwise [m], and heights (S,) [m].
    """
    rng = np.random.default_rng(spec.seed)
    max_angle = np.deg2rad(spec.turn_deg)
    # Half extent of a stone at the largest angle
    half = 0.5 * spec.size * float(np.cos(max_angle) + np.sin(max_angle))
    x_centres, y_centres = (
        a + half + spec.pitch * np.arange(int((b - a - 2 * half) / spec.pitch + 1e-9) + 1)
        for a, b in (spec.x, spec.y)
    )
    centres = np.stack(np.meshgrid(x_centres, y_centres, indexing="ij"), axis=-1).reshape(-1, 2)
    angle = max_angle * rng.uniform(-1, 1, len(centres))
    height = spec.rise * rng.uniform(-1, 1, len(centres))
    is_present = rng.permutation(len(centres)) >= round(spec.missing * len(centres))
    square = 0.5 * spec.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    corners = centres[:, None, :] + square @ np.swapaxes(rotation, -1, -2)
    names = [f"S{k + 1}" for k in np.flatnonzero(is_present)]
    return names, corners[is_present], height[is_present]


_FAR = np.full(2, 1e4)  # [m] beyond all terrain
_MAX_ROLLED_STEP = 1e-3  # [m]


def find_foot_conflicts(ground: Ground, foot: float) -> Iterator[str]:
    """Yield messages where feet of a radius [m] do not fit the terrain's `edge`, one of each kind.

    A foot whose centre is nearer than its radius to higher terrain stands in the side of that
    terrain.
    """
    if foot == 0 or ground.count == 1:
        return
    shapes = np.array([shapely.polygons(_read_outline(ground, k)) for k in range(ground.count)])
    inner = shapely.buffer(shapes, -ground.edge) if ground.edge else shapes
    if (narrow := np.flatnonzero(shapely.is_empty(inner))).size:
        name = ground.names[int(narrow[0])]
        yield f"feet of {foot:g} m have no room within the edges of {name!r}, expected less"
    if ground.edge >= foot - 1e-9:
        return
    first, second = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=foot)
    first, second = first[first != second], second[first != second]
    ends = shapely.get_coordinates(shapely.shortest_line(shapes[first], shapes[second]))
    start, end = ends.reshape(-1, 2, 2).swapaxes(0, 1)
    rise = ground.compute_height(second, end) - ground.compute_height(first, start)
    if (rise > _MAX_ROLLED_STEP).any():
        k = int(np.argmax(rise))
        yield (
            f"feet of {foot:g} m stand in the side of {ground.names[second[k]]!r}, {rise[k]:.3g} m "
            f"above {ground.names[first[k]]!r}: expected at least their radius"
        )


def _read_outline(ground: Ground, region: int) -> Array:
    """Return the corners (C, 2) of a region."""
    outline: Array = ground.outline(region, -_FAR, _FAR)[:, :2]
    return outline


# Published for SCALER: [1/N^2] on force differences, for a robot of that weight [N]
_SCALER_FORCES, _SCALER_WEIGHT = 1e-3, 6.3 * 9.81


@dataclass(frozen=True)
class Walker:
    """A walking robot: its rigid body, standing height and legs."""

    body: RigidBody
    height: float  # [m] of the centre of mass in stance
    legs: WalkingLegs | None  # None: not from a URDF
    foot: float = 0.0  # [m] radius of the feet, 0: points


def build_walker(spec: WalkingRobot) -> Walker:
    """Build the body of a robot file, with its legs if it is a URDF robot.

    Raises:
        MissingSolver: Pinocchio is not installed.
        SpecError: the URDF cannot be used.
    """
    if isinstance(spec, UrdfRobot):
        urdf_body = build_walking_body(spec)
        body = RigidBody(
            name=urdf_body.name,
            leg_names=urdf_body.leg_names,
            mass=urdf_body.mass,
            inertia=urdf_body.inertia,
            gravity=urdf_body.gravity,
            toe_center=urdf_body.boxes.center,
            toe_half=urdf_body.boxes.half,
            force_limit=urdf_body.boxes.force,
        )
        return Walker(body, urdf_body.height, urdf_body.legs, urdf_body.foot)
    body = RigidBody(
        name=spec.name,
        leg_names=tuple(spec.legs),
        mass=spec.mass,
        inertia=np.array(spec.inertia, float),
        gravity=spec.gravity,
        toe_center=np.array(list(spec.legs.values()), float),
        toe_half=np.array(spec.toe_half, float),
        force_limit=spec.force_limit,
    )
    return Walker(body, spec.standing_height, None)


def build_ground(spec: WalkTerrainSpec, foot: float = 0.0) -> Ground:
    """Build the regions and stones of a spec, or flat ground; foot: radius of feet [m]."""
    edge = foot if spec.edge is None else spec.edge
    names = [region.name for region in spec.regions]
    outlines = [np.array(region.outline, float) for region in spec.regions]
    slopes = [_read_slope(region) for region in spec.regions]
    plane_points = [_choose_plane_point(region) for region in spec.regions]
    angular = any(region.corners for region in spec.regions)
    if spec.stones is not None:
        stone_names, corners, stone_heights = sample_stones(spec.stones)
        names += stone_names
        outlines += list(corners)
        slopes += [(0.0, 0.0)] * len(stone_names)
        plane_points += [(0.0, 0.0, float(height)) for height in stone_heights]
        angular |= spec.stones.turn_deg > 0
    if not names:
        return replace(Ground.flat(spec.friction), edge=edge)
    num_corners = max(map(len, outlines)) if angular else 0
    points = np.array(plane_points, float)
    ground = Ground(
        tuple(names),
        np.array([outline.min(axis=0) for outline in outlines]),
        np.array([outline.max(axis=0) for outline in outlines]),
        points[:, 2],
        spec.friction,
        np.array(slopes, float),
        np.stack([_pad_outline(outline, num_corners) for outline in outlines]),
        edge,
    )
    rise = (ground.slope * (ground.inner - points[:, :2])).sum(axis=1)
    return replace(ground, height=ground.height + rise)


def _read_slope(region: LevelRegionSpec) -> tuple[float, float]:
    """Return the rise of a region along x and y."""
    return fit_slope(region.corners) if region.corners else region.slope


def _choose_plane_point(region: LevelRegionSpec) -> tuple[float, float, float]:
    """Return a point (3,) of a region's plane."""
    if region.corners:
        return region.corners[0]
    return (0.5 * sum(region.x), 0.5 * sum(region.y), region.height)


def _pad_outline(outline: Array, count: int) -> Array:
    """Return `count` corners (count, 2) with the last one repeated; none if count is 0."""
    return outline[np.minimum(np.arange(count), len(outline) - 1)]


def build_task(
    spec: MpcSpec, robot: WalkingRobot, source: str = "spec", centres: bool = True
) -> WalkTask:
    """Build the task of a spec, for spherical feet with regions of their centres.

    Args:
        spec: the walk.
        robot: its robot.
        source: name of the spec in messages.
        centres: False for plans that have foot centres on the terrain itself.

    Raises:
        SpecError: a force limit that cannot carry the robot, toes off the terrain.
        MissingSolver: a robot from a URDF, without Pinocchio.
    """
    walker, mistakes = build_walker(robot), []
    body, ground = walker.body, build_ground(spec.terrain, walker.foot)
    if centres and walker.foot:
        ground = shift_to_foot_centres(ground, walker.foot)
    mistakes += [
        SpecMistake("terrain.edge", message) for message in find_foot_conflicts(ground, walker.foot)
    ]
    if 4 * body.force_limit <= body.mass * body.gravity:
        message = (
            f"{body.leg_count} legs of {body.force_limit:g} N cannot carry {body.mass:g} kg "
            f"({body.mass * body.gravity:.1f} N)"
        )
        mistakes.append(SpecMistake("robot", message))
    start, toe_mistakes = _build_start(spec, walker, ground)
    mistakes += toe_mistakes
    if mistakes:
        raise SpecError(source, mistakes)
    weights = spec.weights
    return WalkTask(
        body=body,
        ground=ground,
        knots=spec.task.knots,
        dt=spec.task.dt,
        integrator=spec.task.integrator,
        start=start,
        reference=_build_reference(spec, ground, walker, start.state),
        weights=Weights(
            np.array(weights.velocity, float),
            np.array(weights.angles, float),
            weights.height,
            weights.motion,
            _scale_force_weight(body)
            if weights.force_difference is None
            else weights.force_difference,
        ),
        swing_clearance=spec.task.swing_clearance,
        min_contacts=spec.task.min_contacts,
        workspace_over_stance=spec.task.workspace_over_stance,
        goal=_build_goal(spec.task.goal),
        legs=walker.legs,
    )


def _build_start(spec: MpcSpec, walker: Walker, ground: Ground) -> tuple[Start, list[SpecMistake]]:
    """Return the start of a spec, toes on the terrain, and mistakes in its toes."""
    body, mistakes = walker.body, []
    stated, state = spec.task.start, np.zeros(STATE)
    state[:2] = stated.position
    angles = np.deg2rad(stated.rpy_deg)
    above = walker.height if stated.height is None else stated.height
    state[2] = above + float(compute_ground_height(ground, body, state[None, :2], angles)[0])
    state[VELOCITY], state[SPIN] = stated.velocity, stated.angular_velocity
    state[ANGLES] = angles
    toes = state[POSITION] + body.toe_center @ rotation_world_body(angles).T
    for leg, name in enumerate(body.leg_names):
        if name in stated.toes:
            toes[leg, :2] = stated.toes[name]
        region = int(ground.nearest(toes[leg, :2]))
        off = float(ground.compute_distance_outside(np.array(region), toes[leg, :2]))
        if name in stated.toes and off > 0:
            message = f"{1e3 * off:.1f} mm off {ground.names[region]!r}, the nearest region"
            mistakes.append(SpecMistake(f"task.start.toes.{name}", message))
        if name not in stated.toes:
            toes[leg, :2] = ground.project(np.array(region), toes[leg, :2])
        toes[leg, 2] = ground.compute_height(np.array(region), toes[leg, :2])
    return Start(state, toes), mistakes


def _scale_force_weight(body: RigidBody) -> float:
    """Return the weight of force differences [1/N^2] for forces relative to the robot's weight.

    With forces in newtons a heavy robot would pay more for a step than for lost velocity, and
    stand.
    """
    return _SCALER_FORCES * (_SCALER_WEIGHT / (body.mass * body.gravity)) ** 2


def _build_goal(spec: WalkGoalSpec | None) -> Goal:
    """Return the goal of a spec; anywhere if it has none."""
    if spec is None:
        return Goal.anywhere()
    middle = np.array(spec.position, float)
    return Goal(middle - spec.within, middle + spec.within)


def _build_reference(spec: MpcSpec, ground: Ground, walker: Walker, begin: Array) -> Reference:
    """Return constant velocity and angles; the height follows the terrain on a straight path."""
    spec_reference, knots = spec.task.reference, spec.task.knots
    angles = np.deg2rad(spec_reference.rpy_deg)
    time = spec.task.dt * np.arange(1, knots + 1)
    path = begin[:2] + time[:, None] * np.array(spec_reference.velocity[:2])
    terrain_height = compute_ground_height(ground, walker.body, path, angles)
    height = walker.height if spec_reference.height is None else spec_reference.height
    return Reference(
        velocity=np.tile(np.array(spec_reference.velocity, float), (knots, 1)),
        euler=np.tile(angles, (knots, 1)),
        height=height + terrain_height,
    )


def compute_ground_height(ground: Ground, body: RigidBody, xy: Array, angles: Array) -> Array:
    """Return the mean terrain height (n,) under the feet of a body at points (n, 2) [m]."""
    feet = xy[:, None, :] + (body.toe_center @ rotation_world_body(angles).T)[:, :2]
    region = ground.nearest(feet)
    height: Array = ground.compute_height(region, ground.project(region, feet)).mean(axis=-1)
    return height


def build_sampled_task(task: WalkTask, samples: int) -> WalkTask:
    """Return the task of a closed loop's record, with a number of Runge-Kutta steps."""
    reference = task.reference
    return replace(
        task,
        knots=samples,
        dt=task.sample,
        integrator="rk4",
        reference=replace(
            reference,
            velocity=np.tile(reference.velocity[-1], (samples, 1)),
            euler=np.tile(reference.euler[-1], (samples, 1)),
            height=np.full(samples, reference.height[-1]),
        ),
    )
