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
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.plan.axes import turn_ground_to_walking
from climbplan.walking.plan.foot_centres import shift_to_foot_centres
from climbplan.walking.problem.regions import build_ground
from climbplan.walking.problem.spec_axes import convert_to_walking_axes
from climbplan.walking.schema.loading import WalkingRobot
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.task import WalkGoalSpec, WalkWeightsSpec
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


def build_task(
    spec: MpcSpec,
    robot: WalkingRobot,
    source: str = "spec",
    centres: bool = True,
    scan: RawSurface | None = None,
) -> WalkTask:
    """Build the task of a spec, for spherical feet with regions of their centres.

    The task has x forward; `orient_task` turns it to the axes of the spec.

    Args:
        spec: the walk.
        robot: its robot.
        source: name of the spec in messages.
        centres: False for plans that have foot centres on the terrain itself.
        scan: Raw surface of the terrain in the axes of the spec; None: there is none, or it does
            not matter.

    Raises:
        SpecError: a force limit that cannot carry the robot, toes off the terrain.
        MissingSolver: a robot from a URDF, without Pinocchio.
    """
    walker, mistakes = build_walker(robot), []
    body = walker.body
    ground = replace(build_ground(spec.terrain, walker.foot, body.leg_names), scan=scan)
    if spec.forward == "y":
        ground = turn_ground_to_walking(ground)
    spec = convert_to_walking_axes(spec)
    if centres and walker.foot:
        ground = shift_to_foot_centres(ground, walker.foot)
    if spec.terrain.scan is None:  # regions of a scan keep clear of what rises beside them
        conflicts = find_foot_conflicts(ground, walker.foot)
        mistakes += [SpecMistake("terrain.edge", message) for message in conflicts]
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
    return WalkTask(
        body=body,
        ground=ground,
        knots=spec.task.knots,
        dt=spec.task.dt,
        integrator=spec.task.integrator,
        start=start,
        reference=_build_reference(spec, ground, walker, start.state),
        weights=_build_weights(spec.weights, body),
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
        region = int(ground.find_start_regions(toes[:, :2])[leg])
        off = float(ground.compute_distance_outside(np.array(region), toes[leg, :2]))
        if name in stated.toes and off > 0:
            message = f"{1e3 * off:.1f} mm off {ground.names[region]!r}, the nearest region"
            mistakes.append(SpecMistake(f"task.start.toes.{name}", message))
        if name not in stated.toes:
            toes[leg, :2] = ground.project(np.array(region), toes[leg, :2])
        toes[leg, 2] = ground.compute_height(np.array(region), toes[leg, :2])
    return Start(state, toes), mistakes


def _build_weights(spec: WalkWeightsSpec, body: RigidBody) -> Weights:
    """Return the weights of a spec; that of forces is scaled by the robot's weight if left out."""
    return Weights(
        np.array(spec.velocity, float),
        np.array(spec.angles, float),
        spec.height,
        spec.motion,
        _scale_force_weight(body) if spec.force_difference is None else spec.force_difference,
    )


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
