"""Initial points of the posture NLP: the convex plan, and randomised paths from start to goal.

A local method finds a plan near its initial point, and the choices of regions stay those of the
initial point. So each start passes obstacles on other sides and uses other contact regions.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from climbplan.arrays import Array, IntArray
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.nlp.parameters import Guess, project_onto_surfaces
from climbplan.climb.postures.planner import LINEAR_ROTATION_LIMIT, plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import NoPlanFound
from climbplan.robots.kinematics import to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.model import FreeRegion

_PATH_STD = 0.1  # [m] spread of the body's way about the straight line
_ROTATION_STD = np.deg2rad(4.0)  # spread of its rotation
_TOE_STD = 0.02  # [m] spread of each toe
_DISCONNECTED_COST = (
    1e3  # [m] cost of going from a free region straight to one that it does not meet
)
_START_GAP = 0.01  # a start need not be proved any better
_MAX_DRAWS = 20  # ways drawn before one that is too long is tried all the same
_NUM_SWEEPS = 300  # of smoothing and moving back into the free regions


def build_convex_guess(scene: ClimbScene, time_limit: float) -> Guess | None:
    """Return the plan of method `micp` without lower step bounds; None where that method has no
    answer.

    Its contact regions and its sides of the obstacles have the least cost, as long as rotations are
    small enough for the linearisation.
    """
    level = [0.0, 0.0, scene.start.rpy[2]]
    max_rotation = np.abs(np.array([scene.start.rpy, scene.goal.rpy]) - level).max()
    if scene.terrain.is_curved or max_rotation > LINEAR_ROTATION_LIMIT:
        return None
    spec = scene.spec
    steps = spec.posture.steps.model_copy(update={"com_min": 0.0, "toe_min": 0.0})
    posture = spec.posture.model_copy(update={"steps": steps})
    loose_limits = {"time_limit": time_limit, "gap": max(spec.solver.gap, _START_GAP)}
    solver = spec.solver.model_copy(update=loose_limits)
    convex_spec = spec.model_copy(update={"posture": posture, "solver": solver})
    try:
        rounds = plan_postures(replace(scene, spec=convex_spec)).rounds
    except NoPlanFound:  # no proof for exact rotations: the other starts decide
        return None
    rng = np.random.default_rng([spec.seed, 0])
    return Guess(
        "convex plan", _enforce_min_steps(scene, rounds, rng), _select_free_regions(scene, rounds)
    )


def build_straight_guess(
    scene: ClimbScene, index: int, spread: float, adjacency: RegionAdjacency | None = None
) -> Guess:
    """Return start `index`: body and toes on a path from start to goal.

    Args:
        scene: The climb.
        index: Number of the start, part of its random seed.
        spread: Factor on the random deviation; 0 gives the straight line.
        adjacency: Adjacency of the scene's free regions; None computes it.
    """
    rng = np.random.default_rng([scene.spec.seed, index])
    m, start, goal = scene.spec.task.round_count, scene.start, scene.goal
    path = _sample_body_path(scene, rng, spread, adjacency or find_region_adjacency(scene))

    # Toes keep their place in the body frame, which goes over from that of the start to the goal's
    fraction = np.linspace(0.0, 1.0, m + 1)[:, None, None]
    toes_body_start = to_body(start.com, start.rpy, start.toes)
    toes_body_goal = to_body(goal.com, goal.rpy, goal.toes)
    toes_body = toes_body_start + fraction * (toes_body_goal - toes_body_start)  # (M+1, N, 3)
    toes = path.com[:, None] + np.einsum("jab,jnb->jna", rotation_world_body(path.rpy), toes_body)
    toes[1:-1] += spread * rng.normal(0.0, _TOE_STD, toes[1:-1].shape)
    toes[0], toes[-1] = start.toes, goal.toes
    region = np.empty(toes.shape[:2], np.int64)
    region[0], region[-1] = start.region, goal.region
    for j, i in np.ndindex(m - 1, toes.shape[1]):
        region[j + 1, i] = scene.terrain.nearest_surface(i, toes[j + 1, i])
    rounds = _enforce_min_steps(scene, Rounds(path.com, path.rpy, toes, region), rng)
    return Guess(
        "straight way" if spread == 0 else f"random way {index}", rounds, path.free_regions
    )


@dataclass(frozen=True)
class _BodyCorridor:
    """A path of the body, and its free region in each round."""

    com: Array  # (M+1, 3)
    rpy: Array  # (M+1, 3)
    free_regions: IntArray  # (M, choices)

    @property
    def length(self) -> float:
        """Return the path length of the body origin [m]."""
        return float(np.linalg.norm(np.diff(self.com, axis=0), axis=1).sum())


def _sample_body_path(
    scene: ClimbScene, rng: np.random.Generator, spread: float, adjacency: RegionAdjacency
) -> _BodyCorridor:
    """Sample a path round the obstacles to the goal, no longer than the body's steps allow."""
    m, start, goal = scene.spec.task.round_count, scene.start, scene.goal
    fraction = np.linspace(0.0, 1.0, m + 1)[:, None]
    max_length = m * scene.spec.posture.steps.com_max
    for _ in range(_MAX_DRAWS):
        arch = np.sin(np.pi * fraction) * spread
        com = start.com + fraction * (goal.com - start.com) + arch * rng.normal(0.0, _PATH_STD, 3)
        rpy = (
            start.rpy + fraction * (goal.rpy - start.rpy) + arch * rng.normal(0.0, _ROTATION_STD, 3)
        )
        path = _BodyCorridor(com, rpy, _find_region_path(scene, com, rpy, rng, spread, adjacency))
        if path.free_regions.size == 0:
            return path
        # Drawn taut, then shared out evenly over the rounds, which moves the changes of region
        path = replace(path, com=_tighten_path(scene, path))
        com = _resample_evenly(path.com)
        free_regions = _find_region_path(scene, com, rpy, rng, 0.0, adjacency)
        path = _BodyCorridor(com, rpy, free_regions)
        path = replace(path, com=_tighten_path(scene, path))
        if path.length <= max_length:
            return path
    return path


def repin_guess(scene: ClimbScene, guess: Guess, rounds: Rounds) -> Guess:
    """Return a guess at given postures, with the body's free regions chosen for them."""
    return replace(guess, rounds=rounds, free_regions=_select_free_regions(scene, rounds))


def _enforce_min_steps(scene: ClimbScene, rounds: Rounds, rng: np.random.Generator) -> Rounds:
    """Project toes onto their surfaces, and spread steps below their lower bounds to and fro.

    A lower bound has no gradient at a step of length zero, so no initial point may have one.
    """
    steps = scene.spec.posture.steps
    com, toes = rounds.com.copy(), rounds.toes.copy()
    signs = (-1.0) ** np.arange(1, len(com))[:, None]
    limbs = [(toes[:, i], steps.toe_min) for i in range(toes.shape[1])]
    for points, min_step in ((com, steps.com_min), *limbs):
        shortest_step = np.linalg.norm(np.diff(points, axis=0), axis=1).min()
        if shortest_step < min_step:
            points[1:] += 0.5 * min_step * signs * _sample_direction(rng)
    project_onto_surfaces(scene, toes, rounds.region)
    return replace(rounds, com=com, toes=toes)


def _sample_direction(rng: np.random.Generator) -> Array:
    """Return a uniformly distributed unit vector (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _compute_body_corners(scene: ClimbScene, com: Array, rpy: Array) -> Array:
    """Return the body's corners (M+1, V, 3)."""
    rotated_hull = np.einsum("jab,vb->jva", rotation_world_body(rpy), scene.robot.body_hull)
    return np.asarray(com[:, None] + rotated_hull)


def _measure_violation(scene: ClimbScene, free: FreeRegion, corners: Array) -> Array:
    """Return how far each posture's corners (..., V, 3) are outside a free region (...), negative
    inside.
    """
    keep = scene.spec.posture.body_clearance
    return np.asarray((corners @ free.A.T - free.b + keep).max(axis=(-2, -1)))


def _select_free_regions(scene: ClimbScene, rounds: Rounds) -> IntArray:
    """Return the free regions (M, choices) with the smallest violation in each round."""
    corners = _compute_body_corners(scene, rounds.com, rounds.rpy)
    selected = np.zeros((rounds.count, len(scene.terrain.free_choices)), np.int64)
    for k, choice in enumerate(scene.terrain.free_choices):
        violations = np.stack([_measure_violation(scene, free, corners) for free in choice])
        selected[:, k] = np.maximum(violations[:, :-1], violations[:, 1:]).argmin(axis=0)
    return selected


def _find_region_path(
    scene: ClimbScene,
    com: Array,
    rpy: Array,
    rng: np.random.Generator,
    spread: float,
    adjacency: RegionAdjacency,
) -> IntArray:
    """Return free regions (M, choices) near a path, each adjacent to the next.

    The sequence is a shortest path over rounds, by dynamic programming. With spread, regions have
    random weights in every start, so that starts pass obstacles on different sides.
    """
    corners = _compute_body_corners(scene, com, rpy)
    m = len(com) - 1
    selected = np.zeros((m, len(scene.terrain.free_choices)), np.int64)
    for k, choice in enumerate(scene.terrain.free_choices):
        violations = np.stack(
            [np.maximum(_measure_violation(scene, free, corners), 0.0) for free in choice]
        )
        region_weight = np.exp(spread * rng.normal(0.0, 1.0, len(choice)))
        cost = region_weight[:, None] * np.maximum(
            violations[:, :-1], violations[:, 1:]
        )  # (regions, M)
        transition_cost = _DISCONNECTED_COST * np.logical_not(adjacency[k])
        total, predecessors = cost[:, 0], []
        for j in range(1, m):
            path_costs = total[:, None] + transition_cost  # from row to column
            predecessors.append(path_costs.argmin(axis=0))
            total = path_costs.min(axis=0) + cost[:, j]
        selected[-1, k] = total.argmin()
        for j in range(m - 1, 0, -1):
            selected[j - 1, k] = predecessors[j - 1][selected[j, k]]
    return selected


RegionAdjacency = tuple[Array, ...]
"""Of each choice of free regions, whether the body at the start's angles fits into two at once."""


def find_region_adjacency(scene: ClimbScene) -> RegionAdjacency:
    """Return the adjacency (F, F) of the regions of each choice, by one small linear program per
    pair.
    """
    return tuple(_find_overlaps(scene, c, scene.start.rpy) for c in scene.terrain.free_choices)


def _find_overlaps(scene: ClimbScene, choice: tuple[FreeRegion, ...], rpy: Array) -> Array:
    """Return for all pairs of regions whether the body, rotated by rpy, fits into both at once."""
    hull = scene.robot.body_hull @ rotation_world_body(rpy).T
    keep = scene.spec.posture.body_clearance
    overlaps = np.eye(len(choice), dtype=bool)
    for a, b in itertools.combinations(range(len(choice)), 2):
        rows = np.vstack([choice[a].A, choice[b].A])
        bounds = np.concatenate([choice[a].b, choice[b].b]) - keep - (rows @ hull.T).max(axis=1)
        solution = linprog(np.zeros(3), A_ub=rows, b_ub=bounds, bounds=(None, None))
        overlaps[a, b] = overlaps[b, a] = solution.status == 0
    return overlaps


def _tighten_path(scene: ClimbScene, path: _BodyCorridor) -> Array:
    """Shorten the body's path within the free regions before and after each posture.

    Smoothing steps alternate with projections onto violated halfspaces.
    """
    com = path.com.copy()
    corner_offsets = _compute_body_corners(scene, np.zeros_like(com), path.rpy)
    keep = scene.spec.posture.body_clearance
    rows, bounds = [], []  # (M-1, 3) and (M-1,) for every row of every region
    for k, choice in enumerate(scene.terrain.free_choices):
        for f in range(max(len(free.b) for free in choice)):
            row_index = [min(f, len(free.b) - 1) for free in choice]
            normals = np.array([free.A[p] for free, p in zip(choice, row_index, strict=True)])
            offsets = np.array([free.b[p] for free, p in zip(choice, row_index, strict=True)])
            for region_index in (path.free_regions[:-1, k], path.free_regions[1:, k]):
                reach = np.einsum("jva,ja->jv", corner_offsets[1:-1], normals[region_index]).max(
                    axis=1
                )
                rows.append(normals[region_index])
                bounds.append(offsets[region_index] - keep - reach)
    if not rows:
        return com
    row_array, bound_array = np.array(rows), np.array(bounds)
    for _ in range(_NUM_SWEEPS):
        com[1:-1] = (com[:-2] + com[2:]) / 4 + com[1:-1] / 2
        k = 0
        while k < len(row_array):  # one after the other, those that are kept passed over
            excess = np.maximum(
                np.einsum("kja,ja->kj", row_array[k:], com[1:-1]) - bound_array[k:], 0.0
            )
            is_violated = excess.any(axis=1)
            first = int(np.argmax(is_violated))
            if not is_violated[first]:
                break
            com[1:-1] -= excess[first, :, None] * row_array[k + first]
            k += first + 1
    return com


def _resample_evenly(points: Array) -> Array:
    """Return equally many points, equally spaced along the same polyline."""
    arc_length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    samples = np.linspace(0.0, arc_length[-1], len(points))
    return np.stack([np.interp(samples, arc_length, axis) for axis in points.T], axis=1)
