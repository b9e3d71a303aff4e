"""Where the posture NLP starts: the convex plan, and randomised ways from start to goal.

A local method finds the plan nearest to its start, and its choices of regions stay as they are
in the start. So each start is a different way round the obstacles with other contact regions.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.nlp.numbers import Guess, put_on_surfaces
from climbplan.climb.postures.planner import LINEAR_ROTATION_LIMIT, plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import NoPlanFound
from climbplan.robots.kinematics import to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import FreeRegion

_DETOUR = 0.1  # [m] spread of the body's way about the straight line
_LEAN = np.deg2rad(4.0)  # spread of its rotation
_SCATTER = 0.02  # [m] spread of each toe
_UNREASONABLE = 1e3  # [m] cost of going from a free region straight to one that it does not meet
_ROUGH_GAP = 0.01  # a start need not be proved any better
_DRAWS = 20  # ways drawn before one that is too long is tried all the same
_SWEEPS = 300  # of smoothing and moving back into the free regions


def convex_guess(scene: ClimbScene, time_limit: float) -> Guess | None:
    """The plan of method `micp`, lower step bounds left out; None where that has no answer.

    Its contact regions and its way round the obstacles are those of least cost, as long as
    rotations are small enough for the linearisation.
    """
    level = [0.0, 0.0, scene.start.rpy[2]]
    turned = np.abs(np.array([scene.start.rpy, scene.goal.rpy]) - level).max()
    if scene.terrain.curved or turned > LINEAR_ROTATION_LIMIT:
        return None
    spec = scene.spec
    steps = spec.posture.steps.model_copy(update={"com_min": 0.0, "toe_min": 0.0})
    posture = spec.posture.model_copy(update={"steps": steps})
    rough = {"time_limit": time_limit, "gap": max(spec.solver.gap, _ROUGH_GAP)}
    solver = spec.solver.model_copy(update=rough)
    convex = spec.model_copy(update={"posture": posture, "solver": solver})
    try:
        rounds = plan_postures(replace(scene, spec=convex)).rounds
    except NoPlanFound:  # no proof for exact rotations: the other starts decide
        return None
    rng = np.random.default_rng([spec.seed, 0])
    return Guess("convex plan", _unfold(scene, rounds, rng), _roomiest(scene, rounds))


def straight_guess(
    scene: ClimbScene, index: int, spread: float, meeting: Meeting | None = None
) -> Guess:
    """Start `index`: body and toes on the way from start to goal, `spread` 0 for the direct one.

    meeting: of the scene's free regions, found anew if left out.
    """
    rng = np.random.default_rng([scene.spec.seed, index])
    m, start, goal = scene.spec.task.round_count, scene.start, scene.goal
    way = _body_way(scene, rng, spread, meeting or meeting_regions(scene))

    # Toes keep their place in the body frame, which goes over from that of the start to the goal's
    share = np.linspace(0.0, 1.0, m + 1)[:, None, None]
    first = to_body(start.com, start.rpy, start.toes)
    last = to_body(goal.com, goal.rpy, goal.toes)
    limb = first + share * (last - first)  # (M+1, N, 3)
    toes = way.com[:, None] + np.einsum("jab,jnb->jna", rotation_world_body(way.rpy), limb)
    toes[1:-1] += spread * rng.normal(0.0, _SCATTER, toes[1:-1].shape)
    toes[0], toes[-1] = start.toes, goal.toes
    region = np.empty(toes.shape[:2], np.int64)
    region[0], region[-1] = start.region, goal.region
    for j, i in np.ndindex(m - 1, toes.shape[1]):
        region[j + 1, i] = scene.terrain.nearest_surface(i, toes[j + 1, i])
    rounds = _unfold(scene, Rounds(way.com, way.rpy, toes, region), rng)
    return Guess("straight way" if spread == 0 else f"random way {index}", rounds, way.free)


@dataclass(frozen=True)
class _BodyWay:
    """Where the body goes, and the free region of each round."""

    com: Array  # (M+1, 3)
    rpy: Array  # (M+1, 3)
    free: IntArray  # (M, choices)

    @property
    def length(self) -> float:
        """Way of the body origin [m]."""
        return float(np.linalg.norm(np.diff(self.com, axis=0), axis=1).sum())


def _body_way(
    scene: ClimbScene, rng: np.random.Generator, spread: float, meeting: Meeting
) -> _BodyWay:
    """A way from start to goal round the obstacles, no longer than the body's steps allow."""
    m, start, goal = scene.spec.task.round_count, scene.start, scene.goal
    share = np.linspace(0.0, 1.0, m + 1)[:, None]
    longest = m * scene.spec.posture.steps.com_max
    for _ in range(_DRAWS):
        arch = np.sin(np.pi * share) * spread
        com = start.com + share * (goal.com - start.com) + arch * rng.normal(0.0, _DETOUR, 3)
        rpy = start.rpy + share * (goal.rpy - start.rpy) + arch * rng.normal(0.0, _LEAN, 3)
        way = _BodyWay(com, rpy, _free_regions(scene, com, rpy, rng, spread, meeting))
        if way.free.size == 0:
            return way
        # Drawn taut, then shared out evenly over the rounds, which moves the changes of region
        way = replace(way, com=_taut(scene, way))
        com = _evenly(way.com)
        free = _free_regions(scene, com, rpy, rng, 0.0, meeting)
        way = _BodyWay(com, rpy, free)
        way = replace(way, com=_taut(scene, way))
        if way.length <= longest:
            return way
    return way


def repinned(scene: ClimbScene, guess: Guess, rounds: Rounds) -> Guess:
    """A guess at given postures: the body's free regions are those with most room there."""
    return replace(guess, rounds=rounds, free=_roomiest(scene, rounds))


def _unfold(scene: ClimbScene, rounds: Rounds, rng: np.random.Generator) -> Rounds:
    """Toes onto their surfaces; steps too short for their lower bounds pulled apart to and fro.

    A lower bound has no slope at a step of length zero, so no start may have one.
    """
    steps = scene.spec.posture.steps
    com, toes = rounds.com.copy(), rounds.toes.copy()
    side = (-1.0) ** np.arange(1, len(com))[:, None]
    limbs = [(toes[:, i], steps.toe_min) for i in range(toes.shape[1])]
    for points, least in ((com, steps.com_min), *limbs):
        shortest = np.linalg.norm(np.diff(points, axis=0), axis=1).min()
        if shortest < least:
            points[1:] += 0.5 * least * side * _direction(rng)
    put_on_surfaces(scene, toes, rounds.region)
    return replace(rounds, com=com, toes=toes)


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _corners(scene: ClimbScene, com: Array, rpy: Array) -> Array:
    """Body corners (M+1, V, 3)."""
    turned = np.einsum("jab,vb->jva", rotation_world_body(rpy), scene.robot.body_hull)
    return np.asarray(com[:, None] + turned)


def _misses(scene: ClimbScene, free: FreeRegion, corners: Array) -> Array:
    """By how much each posture's corners (..., V, 3) miss a free region, negative inside (...)."""
    keep = scene.spec.posture.body_clearance
    return np.asarray((corners @ free.A.T - free.b + keep).max(axis=(-2, -1)))


def _roomiest(scene: ClimbScene, rounds: Rounds) -> IntArray:
    """The free region (M, choices) that holds each round best."""
    corners = _corners(scene, rounds.com, rounds.rpy)
    chosen = np.zeros((rounds.count, len(scene.terrain.free_choices)), np.int64)
    for k, choice in enumerate(scene.terrain.free_choices):
        missing = np.stack([_misses(scene, free, corners) for free in choice])
        chosen[:, k] = np.maximum(missing[:, :-1], missing[:, 1:]).argmin(axis=0)
    return chosen


def _free_regions(
    scene: ClimbScene,
    com: Array,
    rpy: Array,
    rng: np.random.Generator,
    spread: float,
    meeting: Meeting,
) -> IntArray:
    """Free regions (M, choices) near a way, each meeting the next (shortest path over rounds).

    With spread, regions weigh differently in every start, so that starts pass obstacles on
    different sides.
    """
    corners = _corners(scene, com, rpy)
    m = len(com) - 1
    chosen = np.zeros((m, len(scene.terrain.free_choices)), np.int64)
    for k, choice in enumerate(scene.terrain.free_choices):
        missing = np.stack([np.maximum(_misses(scene, free, corners), 0.0) for free in choice])
        weight = np.exp(spread * rng.normal(0.0, 1.0, len(choice)))
        cost = weight[:, None] * np.maximum(missing[:, :-1], missing[:, 1:])  # (regions, M)
        apart = _UNREASONABLE * np.logical_not(meeting[k])
        total, came_from = cost[:, 0], []
        for j in range(1, m):
            ways = total[:, None] + apart  # from row to column
            came_from.append(ways.argmin(axis=0))
            total = ways.min(axis=0) + cost[:, j]
        chosen[-1, k] = total.argmin()
        for j in range(m - 1, 0, -1):
            chosen[j - 1, k] = came_from[j - 1][chosen[j, k]]
    return chosen


Meeting = tuple[Array, ...]
"""Of each choice of free regions, whether the body at the start's angles fits into two at once."""


def meeting_regions(scene: ClimbScene) -> Meeting:
    """For all pairs (F, F) of the regions of each choice: small linear programs, one a pair."""
    return tuple(_meeting(scene, c, scene.start.rpy) for c in scene.terrain.free_choices)


def _meeting(scene: ClimbScene, choice: tuple[FreeRegion, ...], rpy: Array) -> Array:
    """Whether the body, turned by rpy, fits into both of two regions at once, for all pairs."""
    hull = scene.robot.body_hull @ rotation_world_body(rpy).T
    keep = scene.spec.posture.body_clearance
    meeting = np.eye(len(choice), dtype=bool)
    for a, b in itertools.combinations(range(len(choice)), 2):
        rows = np.vstack([choice[a].A, choice[b].A])
        bounds = np.concatenate([choice[a].b, choice[b].b]) - keep - (rows @ hull.T).max(axis=1)
        found = linprog(np.zeros(3), A_ub=rows, b_ub=bounds, bounds=(None, None))
        meeting[a, b] = meeting[b, a] = found.status == 0
    return meeting


def _taut(scene: ClimbScene, way: _BodyWay) -> Array:
    """The body's way shortened within the free regions before and after each posture."""
    com = way.com.copy()
    arms = _corners(scene, np.zeros_like(com), way.rpy)
    keep = scene.spec.posture.body_clearance
    rows, bounds = [], []  # (M-1, 3) and (M-1,) for every row of every region
    for k, choice in enumerate(scene.terrain.free_choices):
        for f in range(max(len(free.b) for free in choice)):
            pick = [min(f, len(free.b) - 1) for free in choice]
            normals = np.array([free.A[p] for free, p in zip(choice, pick, strict=True)])
            offsets = np.array([free.b[p] for free, p in zip(choice, pick, strict=True)])
            for chosen in (way.free[:-1, k], way.free[1:, k]):
                reach = np.einsum("jva,ja->jv", arms[1:-1], normals[chosen]).max(axis=1)
                rows.append(normals[chosen])
                bounds.append(offsets[chosen] - keep - reach)
    if not rows:
        return com
    row, bound = np.array(rows), np.array(bounds)
    for _ in range(_SWEEPS):
        com[1:-1] = (com[:-2] + com[2:]) / 4 + com[1:-1] / 2
        k = 0
        while k < len(row):  # one after the other, those that are kept passed over
            over = np.maximum(np.einsum("kja,ja->kj", row[k:], com[1:-1]) - bound[k:], 0.0)
            broken = over.any(axis=1)
            first = int(np.argmax(broken))
            if not broken[first]:
                break
            com[1:-1] -= over[first, :, None] * row[k + first]
            k += first + 1
    return com


def _evenly(points: Array) -> Array:
    """As many points, equally far apart along the same polyline."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], len(points))
    return np.stack([np.interp(at, along, axis) for axis in points.T], axis=1)
