"""What is proved impossible about a climb, whatever method would plan it.

Methods restrict the problem, so what they cannot do proves nothing. Each proof here rests on facts
that every plan of the stated climb satisfies (`verify` holds plans to them), and on values that the
spec states (`climbplan.schema.stated`): the way against the steps allowed, toes against the length
of the limbs, the directions of all friction cones against the load, forces and moments of all that
is within reach of start and goal, and the outer statement of the postures, which has all of the
geometry and the choice of regions in it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.planner.holding import pyramid, unheld
from climbplan.climb.postures.explanation import violated
from climbplan.climb.postures.outer import (
    SLACK,
    longest_reach,
    outer_program,
    own_toes,
    shoulder_balls,
)
from climbplan.climb.postures.ways import ways_too_long
from climbplan.climb.scene.climb_scene import ClimbScene, MotionScene, Stance, load_wrench
from climbplan.climb.schema.model import PostureSpec
from climbplan.errors import Conflict, Infeasible, Remedy
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.stated import stated
from climbplan.solvers.registry import solve
from climbplan.terrain.surfaces import Region

PROOF_SHARE = 0.08  # of a time limit that the search for a proof may use
_LOOSE = 0.5  # relative gap: any point of the outer statement will do


def proof_of_infeasibility(
    scene: ClimbScene, deadline: float, nodes: float = np.inf
) -> Infeasible | None:
    """The error that says why no plan exists, None where that is not proved.

    deadline: `time.monotonic` [s] at which the search for a proof ends, after `nodes` at most.
    """
    from climbplan.solvers.elastic import least_violations

    open_end = scene.spec.task.rounds == "auto"  # as many as it takes are never too few
    far = [] if open_end else list(too_far(scene))
    conflicts = [*buried(scene), *far, *out_of_reach(scene), *no_support(scene)]
    if not conflicts and scene.terrain.scan is None:
        # Regions of a scan are those that were found: its faces may hold where they do not
        conflicts = [Conflict(u.where, (str(u),), in_words=True) for u in unheld(scene)]
    if conflicts:
        return Infeasible("no plan exists", _needed(conflicts), stage="proof")
    if scene.terrain.curved or open_end:
        return None
    left = deadline - time.monotonic()
    if left <= 0:
        return None
    program = outer_program(scene)
    instance = program.at()
    result = solve(instance, "branch-and-bound", gap=_LOOSE, time_limit=left, nodes=nodes)
    if result.status != "infeasible":
        return None
    found = least_violations(instance, _straight(scene))
    if found is not None:
        conflicts = list(violated(scene, program, found))
    head = "no plan exists: no toes and bodies on the way are within reach of each other"
    if conflicts:
        head += "; the closest found still have"
    return Infeasible(head, _needed(conflicts), stage="proof")


def _needed(conflicts: list[Conflict]) -> list[Conflict]:
    """A change that a proof names takes the proof away, and may leave no plan all the same."""
    return [replace(conflict, enough=False) for conflict in conflicts]


def _straight(scene: ClimbScene) -> Array:
    """Toes (M, N, 3) and bodies (M, 3) on the straight way, as a point of the outer program."""
    share = np.linspace(0.0, 1.0, scene.spec.task.round_count + 1)[1:]
    start, goal = scene.start, scene.goal
    toes = start.toes + share[:, None, None] * (goal.toes - start.toes)
    coms = start.com + share[:, None] * (goal.com - start.com)
    return np.concatenate([toes.ravel(), coms.ravel()])


def buried(scene: MotionScene) -> Iterator[Conflict]:
    """Start and goal with the body's origin inside an obstacle, however the goal may be missed."""
    goal = scene.spec.task.goal
    for name, com, room in (
        ("start posture", scene.start.com, 0.0),
        ("goal posture", scene.goal.com, goal.tolerance),
    ):
        for solid in scene.terrain.obstacles:
            depth = -float(solid.face_distance(com)) - room
            if depth > SLACK:
                text = f"the body's middle is {1e3 * (depth + room):.0f} mm inside {solid.name!r}"
                remedy = Remedy(f"another task.{name.split()[0]}.com")
                yield Conflict(name, (text,), (remedy,), in_words=True)


def too_far(scene: ClimbScene) -> Iterator[Conflict]:
    """The way to the goal against the rounds and the steps that the spec states."""
    spec = scene.spec
    ends = zip(own_toes(spec.task.start, scene), own_toes(spec.task.goal, scene), strict=True)
    given = [all(both) for both in ends]
    for way in ways_too_long(scene):
        open_end = way.limb is not None and not given[way.limb]
        if way.key == "rotation_max_deg":
            open_end = not stated(spec, "task.goal.rpy_deg")
        if stated(spec, f"posture.steps.{way.key}") and not open_end:
            yield way.conflict


def out_of_reach(scene: MotionScene) -> Iterator[Conflict]:
    """Start and goal on their own: toes, or all places for a toe, beyond a limb's length."""
    reach = longest_reach(scene)
    if not np.isfinite(reach).all():
        return
    task = scene.spec.task
    for name, posture, stance, room in (
        ("start posture", task.start, scene.start, 0.0),
        ("goal posture", task.goal, scene.goal, task.goal.tolerance),
    ):
        exact = name == "start posture"
        for limb, own in enumerate(own_toes(posture, scene)):
            over = _beyond(scene, stance, limb, own, exact) - reach[limb] - room
            if own:
                over -= room  # the toe too may be that far off
            if over <= SLACK:
                continue
            what = "its toe" if own else "any place where it may stand"
            limb_name = scene.robot.limb_names[limb]
            text = (
                f"{limb_name} cannot reach {what} ({1e3 * over:.1f} mm too far for its links "
                f"stretched out, {1e3 * reach[limb]:.0f} mm)"
            )
            yield Conflict(name, (text,), _nearer(posture, name), in_words=True)


def _nearer(posture: PostureSpec, name: str) -> tuple[Remedy, ...]:
    key = f"task.{name.split()[0]}"
    toes = f" or {key}.toes" if posture.toes else ""
    return (Remedy(f"another {key}.com{toes}"),)


def _beyond(scene: MotionScene, stance: Stance, limb: int, own: bool, exact: bool) -> float:
    """Least distance [m] from a limb's shoulder to its toe, or to all places for it.

    exact: the rotation is the stance's; else any that the spec allows.
    """
    shoulder = scene.robot.shoulder_body
    if exact:
        balls = [(shoulder @ rotation_world_body(stance.rpy).T, np.zeros(len(shoulder)))]
    else:
        balls = shoulder_balls(scene)
    least = 0.0
    for centre, radius in balls:
        point = stance.com + centre[limb]
        if own:
            distance = float(np.linalg.norm(stance.toes[limb] - point))
        else:
            allowed = np.flatnonzero(scene.terrain.allowed[limb])
            distance = min(scene.terrain.surfaces[r].distance(point) for r in allowed)
        least = max(least, distance - radius[limb])
    return least


def no_support(scene: MotionScene) -> Iterator[Conflict]:
    """Friction cones of all places together against the direction of the load.

    Whatever limbs stand wherever, however hard they press: if no sum of forces within the cones of
    the regions that they may use balances weight, payload and stated force, nothing carries the
    robot. A safety factor counts only if the spec states it.
    """
    if scene.grippers is not None or scene.terrain.curved:
        return  # grippers pull; a tube has normals all round
    own = scene.robot.weight * np.array([0.0, 0.0, -1.0])
    load = own + load_wrench(scene.spec, scene.robot, np.zeros(3))[:3]
    if not load.any():
        return
    safety = 1.0
    if stated(scene.spec, "force.safety_friction"):
        safety = scene.spec.force.safety_friction
    allowed = np.asarray(scene.terrain.allowed.any(axis=0))
    regions = [
        surface
        for surface, used in zip(scene.terrain.surfaces, allowed, strict=True)
        if used and isinstance(surface, Region)
    ]
    if _balance(regions, safety, load):
        return
    needed = _least_factor(regions, safety, load)
    names = ", ".join(repr(r.name) for r in regions[:4]) + (", ..." if len(regions) > 4 else "")
    factor = f" (S_mu {safety:g})" if safety > 1 else ""
    text = f"no forces within the friction cones of {names}{factor} carry the robot"
    remedies: list[Remedy] = []
    if needed is not None:
        # Three digits, upwards, and a little more: at the least friction forces are boundless
        mu = math.ceil(1e3 * 1.05 * needed * max(r.friction for r in regions)) / 1e3
        same = all(r.friction == scene.spec.terrain.friction for r in regions)
        remedies.append(Remedy(f"mu > {mu:g}", "terrain.friction" if same else "", mu))
    yield Conflict("every round", (text,), tuple(remedies), in_words=True)


def _balance(regions: list[Region], safety: float, load: Array, factor: float = 1.0) -> bool:
    """Whether forces within pyramids about the cones can balance the load."""
    from climbplan.solvers.highs.linear import LinearProgram, solve_linear

    edges = np.concatenate([pyramid(r, factor * r.friction / safety) for r in regions])
    program = LinearProgram(
        np.ones(len(edges)),
        np.zeros(len(edges)),
        np.full(len(edges), np.inf),
        sparse.csr_matrix(edges.T),
        -load / np.linalg.norm(load) - SLACK,
        -load / np.linalg.norm(load) + SLACK,
    )
    return solve_linear(program).x is not None


def _least_factor(regions: list[Region], safety: float, load: Array) -> float | None:
    """The least factor on all friction coefficients with which the load is carried, to 1 %."""
    low, high = 1.0, 64.0
    if not _balance(regions, safety, load, high):
        return None
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if _balance(regions, safety, load, middle) else (middle, high)
    return high
