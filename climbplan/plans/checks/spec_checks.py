"""The plan answers the spec it carries: bounds, loads, terrain and objective are the spec's.

The robot is not among them: a spec names it, and its data are in the file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.errors import SpecError
from climbplan.plans.checks.check import Array, Check, judge
from climbplan.plans.checks.gait_anew import Gait, gait_of
from climbplan.plans.checks.kinematics_anew import body_axes
from climbplan.plans.climb_plan import ClimbPlan
from climbplan.spec.climb import ClimbSpec, GoalSpec
from climbplan.spec.kinds import validate
from climbplan.spec.motion import MotionSpec
from climbplan.spec.terrain import BoxSpec, GroundSpec, RegionSpec, SolidSpec, WallsSpec
from climbplan.spec.transition import TransitionSpec
from climbplan.spec.yaml_source import parse_yaml
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region, Surface, Tube


@dataclass(frozen=True)
class _Difference:
    """How far a stored value is from the spec's."""

    key: str
    size: float


def spec_checks(plan: ClimbPlan) -> Iterator[Check]:
    """The spec in the file against the numbers in the file."""
    spec = _spec_of(plan)
    if isinstance(spec, str):
        yield judge("file.spec_values", math.inf, spec)
        return
    differences = [*_task(plan, spec), *_limits(plan, spec), *_terrain(plan, spec)]
    worst = max(differences, key=lambda d: math.inf if math.isnan(d.size) else d.size)
    yield judge("file.spec_values", worst.size, worst.key if worst.size > 0 else "")
    yield _objective(plan, spec)


def _spec_of(plan: ClimbPlan) -> ClimbSpec | TransitionSpec | str:
    """The validated spec, or what is wrong with it."""
    try:
        document = parse_yaml(plan.spec_text, "spec")
        spec: ClimbSpec | TransitionSpec | None
        if plan.kind == "climb":
            spec, findings = validate(document, ClimbSpec)
        else:
            spec, findings = validate(document, TransitionSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    if spec is None:
        return findings[0].message
    return spec


def _apart(key: str, stored: Any, asked: Any) -> _Difference:
    """Largest absolute difference; infinite if the shapes differ."""
    a, b = np.asarray(stored, float), np.asarray(asked, float)
    if a.shape != b.shape:
        return _Difference(key, math.inf)
    return _Difference(key, float(np.abs(a - b).max(initial=0.0)))


def _same(key: str, equal: bool) -> _Difference:
    return _Difference(key, 0.0 if equal else math.inf)


def _task(plan: ClimbPlan, spec: MotionSpec) -> Iterator[_Difference]:
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    yield _same("seed", plan.seed == spec.seed)
    whole = spec.all_rounds if isinstance(spec, TransitionSpec) else task.rounds
    last = _last_goal(spec)
    yield _same("task.rounds", rounds.count == whole)
    yield _apart("task.start.com", rounds.com[0], task.start.com)
    yield _apart("task.start.rpy_deg", rounds.rpy[0], np.deg2rad(task.start.rpy_deg))
    yield _apart("task.goal.com", plan.limits.goal_com, last.com)
    yield _apart("task.goal.rpy_deg", plan.limits.goal_rpy, np.deg2rad(last.rpy_deg))
    for key, posture, toes in (
        ("task.start.toes", task.start, rounds.toes[0]),
        ("task.goal.toes", last, plan.limits.goal_toes),
    ):
        for name, toe in posture.toes.items():
            yield _apart(f"{key}.{name}", toes[names.index(name)] if name in names else [], toe)

    gait = gait_of(plan)
    if isinstance(spec, ClimbSpec):
        order = [names[i] for i in gait.order()[: len(names)]]
        yield _same("task.gait", order == list(spec.task.gait or names))
    if isinstance(spec, TransitionSpec):
        yield from _transition(plan, spec, gait)
    stood = rounds.toes[gait.stood[::2], np.arange(len(names))]
    lifts = plan.instants.toes[::2] - stood
    height = np.linalg.norm(lifts[plan.instants.lifted[::2]], axis=-1)
    yield _apart("trajectory.lift", height, np.full_like(height, spec.trajectory.lift))
    span = plan.trajectory.time[-1] - plan.trajectory.time[0]
    rate = (len(plan.trajectory.time) - 1) / span if span > 0 else math.nan
    yield _Difference("trajectory.rate", abs(rate / spec.trajectory.rate - 1))

    # Payload weight at its place on the turned body, and the constant load.
    load = np.tile(
        task.external_wrench.force + task.external_wrench.moment, (len(plan.instants.rpy), 1)
    )
    weight = np.array([0.0, 0.0, -task.payload.mass * plan.robot.gravity])
    arms = np.array(task.payload.offset) @ body_axes(plan.instants.rpy)
    load[:, :3] += weight
    load[:, 3:] += np.cross(arms, weight)
    yield _apart("task.payload, task.external_wrench", plan.instants.external_wrench, load)


def _last_goal(spec: MotionSpec) -> GoalSpec:
    """The goal of the whole plan."""
    return spec.last_goal if isinstance(spec, TransitionSpec) else spec.task.goal


def _transition(plan: ClimbPlan, spec: TransitionSpec, gait: Gait) -> Iterator[_Difference]:
    """Which limbs move together, how far, and the gait of a climb that follows."""
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    first = gait.round <= task.rounds
    moved = gait.moved[first]
    counts = tuple(int(n) for n in moved.sum(axis=1))
    yield _same("task.sequence", task.moving in ((), counts))
    if task.limbs:
        named = [{names[i] for i in np.flatnonzero(step)} for step in moved]
        yield _same("task.sequence", named == [set(limbs) for limbs in task.limbs])
    left = len(names) - max(counts, default=0)
    yield _Difference("task.supporting", float(max(task.supporting - left, 0)))
    at_end = min(task.rounds, rounds.count)
    own = rounds.toes[: at_end + 1]
    steps = np.linalg.norm(np.diff(own, axis=0), axis=-1).max(axis=0)
    for name, largest in task.step_max.items():
        size = float(steps[names.index(name)]) if name in names else math.inf
        yield _Difference(f"task.step_max.{name}", max(size - largest, 0.0))
    if spec.climb is None:
        return
    yield _apart("task.goal.com", rounds.com[at_end], task.goal.com)
    for name, toe in task.goal.toes.items():
        yield _apart(f"task.goal.toes.{name}", own[-1, names.index(name)], toe)
    climb = spec.climb.posture.steps
    pose = np.diff(np.hstack([rounds.com, rounds.rpy])[at_end:], axis=0)
    toes = np.linalg.norm(np.diff(rounds.toes[at_end:], axis=0), axis=-1)
    for key, made, most in (
        ("com_max", np.linalg.norm(pose[:, :3], axis=1), climb.com_max),
        ("toe_max", toes, climb.toe_max),
        ("rotation_max_deg", np.abs(pose[:, 3:]), math.radians(climb.rotation_max_deg)),
    ):
        excess = float(made.max(initial=0.0)) - most
        yield _Difference(f"climb.posture.steps.{key}", max(excess, 0.0))
    order = [names[i] for i in gait.order()[~first]]
    single = (gait.moved[~first].sum(axis=1) == 1).all()
    gaits = list(spec.climb.gait or names) * spec.climb.rounds
    yield _same("climb.gait", bool(single) and order == gaits)


def _limits(plan: ClimbPlan, spec: MotionSpec) -> Iterator[_Difference]:
    limits, steps = plan.limits, spec.posture.steps
    pairs = {
        "posture.steps.com_max": (limits.com_max, steps.com_max),
        "posture.steps.com_min": (limits.com_min, steps.com_min),
        "posture.steps.toe_max": (limits.toe_max, steps.toe_max),
        "posture.steps.toe_min": (limits.toe_min, steps.toe_min),
        "posture.steps.rotation_max_deg": (
            limits.rotation_max,
            math.radians(steps.rotation_max_deg),
        ),
        "posture.body_clearance": (limits.body_clearance, spec.posture.body_clearance),
        "task.goal.tolerance": (limits.goal_tolerance, _last_goal(spec).tolerance),
        "task.goal.rotation_tolerance_deg": (
            limits.goal_rotation_tolerance,
            math.radians(_last_goal(spec).rotation_tolerance_deg),
        ),
        "force.safety_friction": (limits.safety_friction, spec.force.safety_friction),
        "force.safety_torque": (limits.safety_torque, spec.force.safety_torque),
    }
    sag = plan.forces.com_deflection
    yield _same("force.sag", spec.force.sag == "predicted" or not sag.any())
    for key, (stored, asked) in pairs.items():
        yield _apart(key, stored, asked)


def _terrain(plan: ClimbPlan, spec: MotionSpec) -> Iterator[_Difference]:
    terrain, asked = plan.terrain, spec.terrain
    walls = ("left", "right") if asked.walls is not None else ()
    tops = [*(["ground"] if asked.ground else []), *(box.name for box in asked.boxes)]
    names = [*(["tube"] if asked.tube else []), *walls, *tops, *(r.name for r in asked.regions)]
    stored = [surface.name for surface in terrain.surfaces]
    yield _same("terrain: surfaces", stored == names)
    yield _same(
        "terrain.obstacles: names",
        [s.name for s in terrain.obstacles]
        == [*(s.name for s in asked.obstacles), *(box.name for box in asked.boxes)],
    )
    if stored != names:
        return
    by_name = dict(zip(names, range(len(names)), strict=True))
    limbs = plan.robot.limb_names

    if asked.tube is not None:
        tube = terrain.surfaces[by_name["tube"]]
        yield _same("terrain.tube", isinstance(tube, Tube))
        if isinstance(tube, Tube):
            held = (*tube.center, tube.radius, tube.lower, tube.upper, tube.friction)
            want = (*asked.tube.center, asked.tube.radius, *asked.tube.up, asked.friction)
            yield _apart("terrain.tube", held, want)
    if asked.walls is not None:
        for side, name in ((-1, "left"), (1, "right")):
            surface = terrain.surfaces[by_name[name]]
            yield _corners_apart(f"terrain.walls: {name}", surface, _wall(asked.walls, side))
            wall = asked.friction if asked.walls.friction is None else asked.walls.friction
            yield _apart("terrain.friction", surface.friction, wall)
            may = [where in (name, "any") for where in plan.robot.sides]
            yield _apart(f"terrain.walls: {name}, limbs", terrain.allowed[:, by_name[name]], may)
    flats: list[tuple[str, str, Array, GroundSpec | BoxSpec]] = []
    if asked.ground is not None:
        ground = asked.ground
        corners = _level(ground.across, ground.along, ground.height)
        flats.append(("terrain.ground", "ground", corners, ground))
    for number, brick in enumerate(asked.boxes):
        (x0, y0, _), (x1, y1, top) = brick.lower, brick.upper
        corners = _level((x0, x1), (y0, y1), top)
        flats.append((f"terrain.boxes.{number}", brick.name, corners, brick))
    for key, name, corners, level in flats:
        surface = terrain.surfaces[by_name[name]]
        yield _corners_apart(key, surface, corners)
        friction = asked.friction if level.friction is None else level.friction
        yield _apart(f"{key}.friction", surface.friction, friction)
        limbs_allowed = level.limbs if isinstance(level, BoxSpec) else None
        may = [limbs_allowed is None or limb in limbs_allowed for limb in limbs]
        yield _apart(f"{key}.limbs", terrain.allowed[:, by_name[name]], may)
    for number, region in enumerate(asked.regions):
        key = f"terrain.regions.{number}"
        surface = terrain.surfaces[by_name[region.name]]
        yield _corners_apart(key, surface, _region(region))
        friction = asked.friction if region.friction is None else region.friction
        yield _apart(f"{key}.friction", surface.friction, friction)
        may = [region.limbs is None or name in region.limbs for name in limbs]
        yield _apart(f"{key}.limbs", terrain.allowed[:, by_name[region.name]], may)
    boxes = [SolidSpec(name=b.name, lower=b.lower, upper=b.upper) for b in asked.boxes]
    yield from _solids(terrain, [*asked.obstacles, *boxes], asked.free_regions)


def _solids(
    terrain: Terrain, obstacles: Sequence[SolidSpec], free: Sequence[SolidSpec]
) -> Iterator[_Difference]:
    for number, (solid, spec) in enumerate(zip(terrain.obstacles, obstacles, strict=False)):
        yield _support_apart(f"terrain.obstacles.{number}", solid.A, solid.b, _points(spec))
    if free:
        key = "terrain.free_regions"
        choices = terrain.free_choices
        yield _same(key, len(choices) == 1 and len(choices[0]) == len(free))
        for number, (space, spec) in enumerate(
            zip(itertools.chain(*choices[:1]), free, strict=False)
        ):
            yield _support_apart(f"{key}.{number}", space.A, space.b, _points(spec))


def _support_apart(key: str, A: Array, b: Array, points: Array) -> _Difference:
    """How far half-spaces are from touching the hull of points."""
    return _apart(key, (points @ A.T).max(axis=0), b)


def _corners_apart(key: str, surface: Surface, corners: Array) -> _Difference:
    """Largest distance between corners that belong together, in whatever order."""
    if not isinstance(surface, Region) or len(surface.vertices) != len(corners):
        return _Difference(key, math.inf)
    apart = np.linalg.norm(surface.vertices[:, None] - corners[None, :], axis=-1)
    return _Difference(key, float(max(apart.min(axis=0).max(), apart.min(axis=1).max())))


def _wall(walls: WallsSpec, side: int) -> Array:
    """Corners of a wall: half the gap from the middle at y = 0, opening by half the angle."""
    slope = math.tan(math.radians(walls.angle_deg) / 2)
    corners = itertools.product(walls.along, walls.up)
    return np.array([(side * (walls.gap / 2 + y * slope), y, z) for y, z in corners])


def _level(across: tuple[float, float], along: tuple[float, float], z: float) -> Array:
    """Corners of a level rectangle."""
    return np.array([(x, y, z) for x in across for y in along])


def _region(region: RegionSpec) -> Array:
    """Corners of a region as its spec states them."""
    if region.rectangle is None:
        return np.array(region.vertices, float)
    flat = region.rectangle
    x, y, z = np.array(flat.normal) / np.linalg.norm(flat.normal)
    level = math.hypot(x, y)
    across = np.array([-y, x, 0.0]) / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    up = np.cross((x, y, z), across)
    ends = itertools.product((-0.5, 0.5), repeat=2)
    return np.array([flat.center + s * flat.width * across + t * flat.height * up for s, t in ends])


def _points(solid: SolidSpec) -> Array:
    if solid.lower is not None and solid.upper is not None:
        return np.array(list(itertools.product(*zip(solid.lower, solid.upper, strict=True))))
    return np.array(solid.vertices, float)


def _objective(plan: ClimbPlan, spec: MotionSpec) -> Check:
    """The posture cost of chapter 5.1.3 at the stored postures; no bound above it."""
    weights, rounds, limits = spec.posture.weights, plan.rounds, plan.limits
    turn = rounds.rpy[-1] - limits.goal_rpy
    cost = (
        weights.goal * np.sum((rounds.toes[-1] - limits.goal_toes) ** 2)
        + weights.goal_com * np.sum((rounds.com[-1] - limits.goal_com) ** 2)
        + weights.goal_rotation * np.sum(turn**2)
        + weights.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + weights.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + weights.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
    )
    if isinstance(spec, TransitionSpec):
        cost += spec.posture.weights.effort * np.sum(1 / plan.forces.safety_torque[::2])
    scale = max(abs(cost), 1e-6)
    residual = abs(plan.objective - cost) / scale
    place = f"stored {plan.objective:.6g}, postures cost {cost:.6g}"
    if plan.bound is not None and (plan.bound - cost) / scale > residual:
        residual = (plan.bound - cost) / scale
        place = f"bound {plan.bound:.6g} above the cost {cost:.6g}"
    return judge("file.objective", residual, place)
