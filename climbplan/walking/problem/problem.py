"""From an MPC spec to the numbers of its task, random stepping stones included."""

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
from climbplan.walking.plan.foot_centres import on_centres
from climbplan.walking.schema.loading import WalkingRobot
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkGoalSpec
from climbplan.walking.schema.terrain import (
    LevelRegionSpec,
    SteppingStonesSpec,
    WalkTerrainSpec,
    plane_of,
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


def drawn_stones(spec: SteppingStonesSpec) -> tuple[list[str], Array, Array]:
    """Names, corners (S, 4, 2) counterclockwise and heights (S,) [m] of the stones that are there.

    A stone has the same turn and height whatever else is missing. Names count missing ones, too.
    """
    rng = np.random.default_rng(spec.seed)
    most = np.deg2rad(spec.turn_deg)
    half = 0.5 * spec.size * float(np.cos(most) + np.sin(most))  # of a stone that is turned most
    along, across = (
        a + half + spec.pitch * np.arange(int((b - a - 2 * half) / spec.pitch + 1e-9) + 1)
        for a, b in (spec.x, spec.y)
    )
    middle = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
    turn = most * rng.uniform(-1, 1, len(middle))
    height = spec.rise * rng.uniform(-1, 1, len(middle))
    there = rng.permutation(len(middle)) >= round(spec.missing * len(middle))
    square = 0.5 * spec.size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    corners = middle[:, None, :] + square @ np.swapaxes(rotation, -1, -2)
    names = [f"S{k + 1}" for k in np.flatnonzero(there)]
    return names, corners[there], height[there]


_FAR = np.full(2, 1e4)  # [m] beyond all ground
_STEP = 1e-3  # [m] that a foot rolls over


def too_near(ground: Ground, foot: float) -> Iterator[str]:
    """Why feet of a radius [m] do not fit the ground's `edge`: one reason of each kind.

    A foot whose centre is nearer than its radius to higher ground stands in that ground's side.
    """
    if foot == 0 or ground.count == 1:
        return
    shapes = np.array([shapely.polygons(_outline(ground, k)) for k in range(ground.count)])
    inner = shapely.buffer(shapes, -ground.edge) if ground.edge else shapes
    if (narrow := np.flatnonzero(shapely.is_empty(inner))).size:
        name = ground.names[int(narrow[0])]
        yield f"feet of {foot:g} m have no room within the edges of {name!r}, expected less"
    if ground.edge >= foot - 1e-9:
        return
    one, other = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=foot)
    one, other = one[one != other], other[one != other]
    ends = shapely.get_coordinates(shapely.shortest_line(shapes[one], shapes[other]))
    here, there = ends.reshape(-1, 2, 2).swapaxes(0, 1)
    rise = ground.level_at(other, there) - ground.level_at(one, here)
    if (rise > _STEP).any():
        k = int(np.argmax(rise))
        yield (
            f"feet of {foot:g} m stand in the side of {ground.names[other[k]]!r}, {rise[k]:.3g} m "
            f"above {ground.names[one[k]]!r}: expected at least their radius"
        )


def _outline(ground: Ground, region: int) -> Array:
    outline: Array = ground.outline(region, -_FAR, _FAR)[:, :2]
    return outline


# Published for SCALER: [1/N^2] on force differences, for a robot of that weight [N]
_SCALER_FORCES, _SCALER_WEIGHT = 1e-3, 6.3 * 9.81


@dataclass(frozen=True)
class Walker:
    """What walks."""

    body: RigidBody
    height: float  # [m] of its centre of mass as it stands
    legs: WalkingLegs | None  # of a robot from a URDF
    foot: float = 0.0  # [m] radius of its feet, 0 of points


def build_walker(spec: WalkingRobot) -> Walker:
    """The body that a robot file describes, with its legs where it has any.

    Raises MissingSolver and SpecError for robots from URDFs, as `walking_body`.
    """
    if isinstance(spec, UrdfRobot):
        found = build_walking_body(spec)
        body = RigidBody(
            name=found.name,
            leg_names=found.leg_names,
            mass=found.mass,
            inertia=found.inertia,
            gravity=found.gravity,
            toe_center=found.boxes.center,
            toe_half=found.boxes.half,
            force_limit=found.boxes.force,
        )
        return Walker(body, found.height, found.legs, found.foot)
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
    """The regions and stones of a spec, or flat ground; foot: radius of feet [m]."""
    edge = foot if spec.edge is None else spec.edge
    names = [region.name for region in spec.regions]
    outlines = [np.array(region.outline, float) for region in spec.regions]
    slopes = [_slope(region) for region in spec.regions]
    known = [_known_point(region) for region in spec.regions]
    angular = any(region.corners for region in spec.regions)
    if spec.stones is not None:
        named, corners, raised = drawn_stones(spec.stones)
        names += named
        outlines += list(corners)
        slopes += [(0.0, 0.0)] * len(named)
        known += [(0.0, 0.0, float(height)) for height in raised]
        angular |= spec.stones.turn_deg > 0
    if not names:
        return replace(Ground.flat(spec.friction), edge=edge)
    most = max(map(len, outlines)) if angular else 0
    points = np.array(known, float)
    ground = Ground(
        tuple(names),
        np.array([outline.min(axis=0) for outline in outlines]),
        np.array([outline.max(axis=0) for outline in outlines]),
        points[:, 2],
        spec.friction,
        np.array(slopes, float),
        np.stack([_padded(outline, most) for outline in outlines]),
        edge,
    )
    rise = (ground.slope * (ground.inner - points[:, :2])).sum(axis=1)
    return replace(ground, height=ground.height + rise)


def _slope(region: LevelRegionSpec) -> tuple[float, float]:
    return plane_of(region.corners) if region.corners else region.slope


def _known_point(region: LevelRegionSpec) -> tuple[float, float, float]:
    """A point of the plane."""
    if region.corners:
        return region.corners[0]
    return (0.5 * sum(region.x), 0.5 * sum(region.y), region.height)


def _padded(outline: Array, count: int) -> Array:
    """So many corners (count, 2), the last one repeated; none if count is 0."""
    return outline[np.minimum(np.arange(count), len(outline) - 1)]


def build_task(
    spec: MpcSpec, robot: WalkingRobot, source: str = "spec", centres: bool = True
) -> WalkTask:
    """The task of a spec, by centres of spherical feet before they are raised (`foot_centres.py`).

    centres: False of plans that have centres of feet on the ground itself.

    Raises:
        SpecError: a force limit that cannot carry the robot, stated toes off the ground.
        MissingSolver: a robot from a URDF, without Pinocchio.
    """
    walker, mistakes = build_walker(robot), []
    body, ground = walker.body, build_ground(spec.terrain, walker.foot)
    if centres and walker.foot:
        ground = on_centres(ground, walker.foot)
    mistakes += [SpecMistake("terrain.edge", word) for word in too_near(ground, walker.foot)]
    if 4 * body.force_limit <= body.mass * body.gravity:
        message = (
            f"{body.leg_count} legs of {body.force_limit:g} N cannot carry {body.mass:g} kg "
            f"({body.mass * body.gravity:.1f} N)"
        )
        mistakes.append(SpecMistake("robot", message))
    start, begin = spec.task.start, np.zeros(STATE)
    begin[:2] = start.position
    angles = np.deg2rad(start.rpy_deg)
    above = walker.height if start.height is None else start.height
    begin[2] = above + float(ground_under(ground, body, begin[None, :2], angles)[0])
    begin[VELOCITY], begin[SPIN] = start.velocity, start.angular_velocity
    begin[ANGLES] = angles
    toes = begin[POSITION] + body.toe_center @ rotation_world_body(angles).T
    for leg, name in enumerate(body.leg_names):
        if name in start.toes:
            toes[leg, :2] = start.toes[name]
        region = int(ground.nearest(toes[leg, :2]))
        off = float(ground.outside(np.array(region), toes[leg, :2]))
        if name in start.toes and off > 0:
            message = f"{1e3 * off:.1f} mm off {ground.names[region]!r}, the nearest region"
            mistakes.append(SpecMistake(f"task.start.toes.{name}", message))
        if name not in start.toes:
            toes[leg, :2] = ground.into(np.array(region), toes[leg, :2])
        toes[leg, 2] = ground.level_at(np.array(region), toes[leg, :2])
    if mistakes:
        raise SpecError(source, mistakes)
    weights = spec.weights
    return WalkTask(
        body=body,
        ground=ground,
        knots=spec.task.knots,
        dt=spec.task.dt,
        integrator=spec.task.integrator,
        start=Start(begin, toes),
        reference=_reference(spec, ground, walker, begin),
        weights=Weights(
            np.array(weights.velocity, float),
            np.array(weights.angles, float),
            weights.height,
            weights.motion,
            _force_weight(body) if weights.force_difference is None else weights.force_difference,
        ),
        swing_clearance=spec.task.swing_clearance,
        min_contacts=spec.task.min_contacts,
        workspace_over_stance=spec.task.workspace_over_stance,
        goal=_goal(spec.task.goal),
        legs=walker.legs,
    )


def _force_weight(body: RigidBody) -> float:
    """Weight of force differences [1/N^2]: forces count in parts of what the robot weighs.

    In newtons a heavy robot would pay for every step by more than its velocity is worth, and stand.
    """
    return _SCALER_FORCES * (_SCALER_WEIGHT / (body.mass * body.gravity)) ** 2


def _goal(spec: WalkGoalSpec | None) -> Goal:
    if spec is None:
        return Goal.anywhere()
    middle = np.array(spec.position, float)
    return Goal(middle - spec.within, middle + spec.within)


def _reference(spec: MpcSpec, ground: Ground, walker: Walker, begin: Array) -> Reference:
    """Constant velocity and angles; the height follows the ground along the straight way."""
    wanted, knots = spec.task.reference, spec.task.knots
    angles = np.deg2rad(wanted.rpy_deg)
    time = spec.task.dt * np.arange(1, knots + 1)
    way = begin[:2] + time[:, None] * np.array(wanted.velocity[:2])
    below = ground_under(ground, walker.body, way, angles)
    height = walker.height if wanted.height is None else wanted.height
    return Reference(
        velocity=np.tile(np.array(wanted.velocity, float), (knots, 1)),
        euler=np.tile(angles, (knots, 1)),
        height=height + below,
    )


def ground_under(ground: Ground, body: RigidBody, xy: Array, angles: Array) -> Array:
    """Mean height (n,) of the ground under the feet of a body at points (n, 2)."""
    feet = xy[:, None, :] + (body.toe_center @ rotation_world_body(angles).T)[:, :2]
    region = ground.nearest(feet)
    below: Array = ground.level_at(region, ground.into(region, feet)).mean(axis=-1)
    return below


def sampled_task(task: WalkTask, samples: int) -> WalkTask:
    """The task of a loop's record: so many Runge-Kutta steps after the first sample."""
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
