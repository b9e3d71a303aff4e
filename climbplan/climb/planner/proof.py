"""Proofs that a climb has no plan, whatever method would search for it.

Methods restrict the problem, so their failure proves nothing. Each proof here is a relaxation: it
uses only facts that every plan of the stated climb satisfies, which `verify` checks, and values
that the spec states (`climbplan.schema.stated`). The relaxations are, from cheap to expensive:

- the distance to the goal against the number and the length of the steps;
- toes against the stretched length of the limbs;
- the sum of all friction cones against the load's direction;
- forces and moments of all regions within reach of start and goal;
- the outer relaxation of the posture problem, with all of the geometry and region assignment.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.planner.static_feasibility import build_pyramid_edges, find_unsupported_places
from climbplan.climb.postures.explanation import describe_violations
from climbplan.climb.postures.outer_relaxation import (
    SLACK,
    bound_shoulders,
    build_outer_program,
    compute_max_reach,
    find_stated_toes,
)
from climbplan.climb.postures.travel_distance import find_excessive_travel
from climbplan.climb.scene.climb_scene import (
    ClimbScene,
    ClimbStance,
    MotionScene,
    compute_load_wrench,
)
from climbplan.climb.schema.model import PostureSpec
from climbplan.errors import Conflict, Infeasible, Remedy
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.stated import is_stated
from climbplan.solvers.registry import solve
from climbplan.terrain.surfaces import Region

PROOF_TIME_FRACTION = 0.08  # of a time limit that the search for a proof may use
_LOOSE_GAP = 0.5  # relative gap: any point of the outer statement will do


def prove_infeasibility(
    scene: ClimbScene, deadline: float, nodes: float = np.inf
) -> Infeasible | None:
    """Return the error that says why no plan exists, or None where that is not proved.

    Args:
        scene: The climb.
        deadline: `time.monotonic` [s] at which the search for a proof ends.
        nodes: Largest number of branch-and-bound nodes of that search.
    """
    from climbplan.solvers.elastic import minimise_violations

    rounds_are_free = scene.spec.task.rounds == "auto"  # as many as it takes are never too few
    too_long = [] if rounds_are_free else list(find_paths_too_long(scene))
    conflicts = [
        *find_buried_postures(scene),
        *too_long,
        *find_unreachable_toes(scene),
        *find_missing_support(scene),
    ]
    if not conflicts and scene.terrain.scan is None:
        # Regions of a scan are those that were found: its faces may hold where they do not
        conflicts = [
            Conflict(place.place, (str(place),), in_words=True)
            for place in find_unsupported_places(scene)
        ]
    if conflicts:
        return Infeasible("no plan exists", _mark_remedies_necessary(conflicts), stage="proof")
    if scene.terrain.is_curved or rounds_are_free:
        return None
    remaining = deadline - time.monotonic()
    if remaining <= 0:
        return None
    program = build_outer_program(scene)
    instance = program.instantiate()
    result = solve(instance, "branch-and-bound", gap=_LOOSE_GAP, time_limit=remaining, nodes=nodes)
    if result.status != "infeasible":
        return None
    closest_point = minimise_violations(instance, _interpolate_postures(scene))
    if closest_point is not None:
        conflicts = list(describe_violations(scene, program, closest_point))
    head = "no plan exists: no toes and bodies on the way are within reach of each other"
    if conflicts:
        head += "; the closest found still have"
    return Infeasible(head, _mark_remedies_necessary(conflicts), stage="proof")


def _mark_remedies_necessary(conflicts: list[Conflict]) -> list[Conflict]:
    """Return the conflicts with remedies marked as necessary but perhaps not sufficient."""
    return [replace(conflict, enough=False) for conflict in conflicts]


def _interpolate_postures(scene: ClimbScene) -> Array:
    """Return toes (M, N, 3) and bodies (M, 3) on the straight line to the goal, as one point."""
    fraction = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)[1:]
    start, goal = scene.start, scene.goal
    toes = start.toes + fraction[:, None, None] * (goal.toes - start.toes)
    coms = start.com + fraction[:, None] * (goal.com - start.com)
    return np.concatenate([toes.ravel(), coms.ravel()])


def find_buried_postures(scene: MotionScene) -> Iterator[Conflict]:
    """Yield a conflict for start or goal with the body's origin inside an obstacle.

    The goal counts as inside only if every origin within its tolerance is.
    """
    goal = scene.spec.task.goal
    for name, com, tolerance in (
        ("start posture", scene.start.com, 0.0),
        ("goal posture", scene.goal.com, goal.tolerance),
    ):
        for solid in scene.terrain.obstacles:
            depth = -float(solid.face_distance(com)) - tolerance
            if depth > SLACK:
                text = (
                    f"the body's middle is {1e3 * (depth + tolerance):.0f} mm inside {solid.name!r}"
                )
                remedy = Remedy(f"another task.{name.split()[0]}.com")
                yield Conflict(name, (text,), (remedy,), in_words=True)


def find_paths_too_long(scene: ClimbScene) -> Iterator[Conflict]:
    """Yield distances to the goal that the stated rounds and step lengths cannot cover."""
    spec = scene.spec
    ends = zip(
        find_stated_toes(spec.task.start, scene),
        find_stated_toes(spec.task.goal, scene),
        strict=True,
    )
    has_stated_ends = [all(both) for both in ends]
    for excess in find_excessive_travel(scene):
        end_is_free = excess.limb is not None and not has_stated_ends[excess.limb]
        if excess.key == "rotation_max_deg":
            end_is_free = not is_stated(spec, "task.goal.rpy_deg")
        if is_stated(spec, f"posture.steps.{excess.key}") and not end_is_free:
            yield excess.conflict


def find_unreachable_toes(scene: MotionScene) -> Iterator[Conflict]:
    """Yield limbs whose toe, or every possible toe, is out of reach at start or goal."""
    reach = compute_max_reach(scene)
    if not np.isfinite(reach).all():
        return
    task = scene.spec.task
    for name, posture, stance, tolerance in (
        ("start posture", task.start, scene.start, 0.0),
        ("goal posture", task.goal, scene.goal, task.goal.tolerance),
    ):
        rotation_is_fixed = name == "start posture"
        for limb, has_stated_toe in enumerate(find_stated_toes(posture, scene)):
            shortfall = (
                _measure_min_distance(scene, stance, limb, has_stated_toe, rotation_is_fixed)
                - reach[limb]
                - tolerance
            )
            if has_stated_toe:
                shortfall -= tolerance  # the toe too may be that far off
            if shortfall <= SLACK:
                continue
            target = "its toe" if has_stated_toe else "any place where it may stand"
            limb_name = scene.robot.limb_names[limb]
            text = (
                f"{limb_name} cannot reach {target} ({1e3 * shortfall:.1f} mm too far for its "
                f"links stretched out, {1e3 * reach[limb]:.0f} mm)"
            )
            yield Conflict(name, (text,), _suggest_nearer(posture, name), in_words=True)


def _suggest_nearer(posture: PostureSpec, name: str) -> tuple[Remedy, ...]:
    """Return the remedy to state a posture in which toes are nearer to the body."""
    key = f"task.{name.split()[0]}"
    toes = f" or {key}.toes" if posture.toes else ""
    return (Remedy(f"another {key}.com{toes}"),)


def _measure_min_distance(
    scene: MotionScene,
    stance: ClimbStance,
    limb: int,
    has_stated_toe: bool,
    rotation_is_fixed: bool,
) -> float:
    """Return the smallest distance [m] from a limb's shoulder to its toe, or to any region for it.

    Args:
        scene: The climb.
        stance: Start or goal.
        limb: Index of the limb.
        has_stated_toe: Whether the spec states the toe; else every allowed region counts.
        rotation_is_fixed: Whether the body has the stance's rotation; else any that the spec
            allows.
    """
    shoulder = scene.robot.shoulder_body
    if rotation_is_fixed:
        balls = [(shoulder @ rotation_world_body(stance.rpy).T, np.zeros(len(shoulder)))]
    else:
        balls = bound_shoulders(scene)
    min_distance = 0.0
    for centre, radius in balls:
        point = stance.com + centre[limb]
        if has_stated_toe:
            distance = float(np.linalg.norm(stance.toes[limb] - point))
        else:
            allowed = np.flatnonzero(scene.terrain.allowed[limb])
            distance = min(scene.terrain.surfaces[r].distance(point) for r in allowed)
        min_distance = max(min_distance, distance - radius[limb])
    return min_distance


def find_missing_support(scene: MotionScene) -> Iterator[Conflict]:
    """Yield a conflict if the friction cones of all regions together cannot balance the load's
    force.

    Moments, reach and the number of limbs are left out. If no sum of forces within the cones of the
    allowed regions balances weight, payload and stated force, nothing carries the robot. A safety
    factor counts only if the spec states it.
    """
    if scene.grippers is not None or scene.terrain.is_curved:
        return  # grippers pull; a tube has normals all round
    weight = scene.robot.weight * np.array([0.0, 0.0, -1.0])
    load = weight + compute_load_wrench(scene.spec, scene.robot, np.zeros(3))[:3]
    if not load.any():
        return
    safety = 1.0
    if is_stated(scene.spec, "force.safety_friction"):
        safety = scene.spec.force.safety_friction
    allowed = np.asarray(scene.terrain.allowed.any(axis=0))
    regions = [
        surface
        for surface, is_allowed in zip(scene.terrain.surfaces, allowed, strict=True)
        if is_allowed and isinstance(surface, Region)
    ]
    if _can_balance(regions, safety, load):
        return
    min_factor = _find_min_friction_factor(regions, safety, load)
    names = ", ".join(repr(r.name) for r in regions[:4]) + (", ..." if len(regions) > 4 else "")
    factor = f" (S_mu {safety:g})" if safety > 1 else ""
    text = f"no forces within the friction cones of {names}{factor} carry the robot"
    remedies: list[Remedy] = []
    if min_factor is not None:
        # Three digits, upwards, and a little more: at the least friction forces are boundless
        mu = math.ceil(1e3 * 1.05 * min_factor * max(r.friction for r in regions)) / 1e3
        has_common_friction = all(r.friction == scene.spec.terrain.friction for r in regions)
        remedies.append(
            Remedy(f"mu > {mu:g}", "terrain.friction" if has_common_friction else "", mu)
        )
    yield Conflict("every round", (text,), tuple(remedies), in_words=True)


def _can_balance(regions: list[Region], safety: float, load: Array, factor: float = 1.0) -> bool:
    """Return whether forces within pyramids about the cones can balance the load."""
    from climbplan.solvers.highs.linear import LinearProgram, solve_linear

    edges = np.concatenate([build_pyramid_edges(r, factor * r.friction / safety) for r in regions])
    program = LinearProgram(
        np.ones(len(edges)),
        np.zeros(len(edges)),
        np.full(len(edges), np.inf),
        sparse.csr_matrix(edges.T),
        -load / np.linalg.norm(load) - SLACK,
        -load / np.linalg.norm(load) + SLACK,
    )
    return solve_linear(program).x is not None


def _find_min_friction_factor(regions: list[Region], safety: float, load: Array) -> float | None:
    """Return the smallest factor on all friction coefficients that balances the load, to 1 %."""
    low, high = 1.0, 64.0
    if not _can_balance(regions, safety, load, high):
        return None
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if _can_balance(regions, safety, load, middle) else (middle, high)
    return high
