"""Solve the program with complementarity constraints by homotopy in an exact penalty, multi-start.

A homotopy solves the program for increasing weights of the complementarity products. If all pairs
are complementary at its end, the point is a contact sequence with its surfaces. The motion is then
planned again with that sequence fixed, so no tolerance of complementarity remains in a plan.
Otherwise limbs that violate their pairs, and some random ones, are assigned other rounds to move
in, and the program is solved again from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.transition.complementarity_data import (
    ComplementarityData,
    build_complementarity_data,
    compute_dependent_variables,
)
from climbplan.climb.transition.footholds import (
    GOAL,
    START,
    CandidateBodyPoses,
    CandidateFootholds,
    compute_reach,
    list_footholds,
)
from climbplan.climb.transition.pose_paths import ContactSequence, State
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import compute_step_limits
from climbplan.climb.transition.stance_forces import SearchTables

PENALTIES = (0.3, 3.0, 30.0)  # weights of the products; the last two after a perturbation
_FEASIBILITY_TOLERANCE = 1e-5  # of the constraints of a complementary point
_MIN_STEP = 0.02  # [m] shorter steps are none
_NOISE = 0.05  # [m] on random starts
_MAX_HOMOTOPIES = 60  # homotopies of one start
_MAX_DRAWS = 50  # of rounds for limbs, until they differ from earlier ones
_INITIAL_PRESSURE = 0.3  # initial pressure by the weight

VerifySequence = Callable[[SearchTables, ContactSequence], str]


@dataclass(frozen=True)
class StartResult:
    """The result of one random start."""

    seed: int
    reason: str  # why there is no motion, empty if there is one
    num_homotopies: int  # homotopies, the first from the random start itself
    num_complementary: int  # of them ended with all pairs complementing each other
    seconds: float  # including the verification
    iterations: int  # of IPOPT


def run_from_start(
    scene: TransitionScene, seed: int, try_sequence: VerifySequence, deadline: float = np.inf
) -> StartResult:
    """Run homotopies from a random start until one leads to a motion.

    Args:
        scene: The scene.
        seed: Seed of the start and of perturbations.
        try_sequence: Called with each new contact sequence; returns a reason against it or "".
        deadline: Time limit in `time.monotonic` seconds.
    """
    begin = time.perf_counter()
    data, footholds = build_complementarity_data(scene), list_footholds(scene)
    rng = np.random.default_rng(seed)
    v = np.clip(_draw_start(data, rng), data.lower, data.upper)
    drawn_paths: set[bytes] = set()
    tried_sequences: set[bytes] = set()
    iterations = num_complementary = num_homotopies = 0
    reason = "no point found at which all pairs complement each other"
    penalties: tuple[float, ...] = PENALTIES
    while num_homotopies < _MAX_HOMOTOPIES and time.monotonic() < deadline:
        num_homotopies += 1
        v, num_iterations, is_complementary_point = _run_homotopy(data, v, penalties, deadline)
        iterations += num_iterations
        if is_complementary_point:
            num_complementary += 1
            tables, sequence = extract_sequence(data, v)
            is_new = sequence.moves.tobytes() not in tried_sequences
            tried_sequences.add(sequence.moves.tobytes())
            if is_new and is_admissible(scene, sequence.moves):
                reason = try_sequence(tables, sequence)
                if not reason:
                    seconds = time.perf_counter() - begin
                    return StartResult(
                        seed, "", num_homotopies, num_complementary, seconds, iterations
                    )
        v = _perturb_rounds(data, footholds, v, rng, drawn_paths)
        penalties = PENALTIES[1:]
    seconds = time.perf_counter() - begin
    return StartResult(seed, reason, num_homotopies, num_complementary, seconds, iterations)


def _run_homotopy(
    data: ComplementarityData, v: Array, penalties: tuple[float, ...], deadline: float
) -> tuple[Array, int, bool]:
    """Run a homotopy; return its end, IPOPT's iterations, and whether that is complementary."""
    program, iterations = data.program.penalised, 0
    bounds = data.bounds(program.formulation)
    for penalty in penalties:
        p = program.formulation.theta(data.parameters | {"penalty": penalty})
        point = program.solver.solve(v, p, bounds, deadline)
        v = np.clip(point.v, data.lower, data.upper)
        iterations += point.iterations
    return v, iterations, is_complementary(data, v)


def is_complementary(data: ComplementarityData, v: Array) -> bool:
    """Return whether all pairs of a point are complementary and all other constraints hold."""
    formulation = data.program.formulation
    rows = np.array(data.program.rows(v, formulation.theta(data.parameters))).ravel()
    bounds = data.bounds(formulation)
    residuals = formulation.residuals(rows, (bounds.row_lower, bounds.row_upper))
    return all(block.residual <= _FEASIBILITY_TOLERANCE for block in residuals)


def _draw_start(data: ComplementarityData, rng: np.random.Generator) -> Array:
    """Draw a start: poses and toes on their straight paths, contacts and pressures at random."""
    scene, shape = data.scene, data.shape
    n, m = shape.limbs, shape.rounds
    start, goal = scene.start, scene.goal
    fractions = np.sort(rng.uniform(0.0, 1.0, (m + 1, n)), axis=0)[1:, :, None]
    pose, toe = np.empty((m, 6)), np.empty((m, n, 3))
    force, hold = np.zeros((m, n * shape.surfaces, 3)), np.empty((m, n))
    for j in range(m):
        fraction = j / m
        pose[j, :3] = start.com + fraction * (goal.com - start.com) + _NOISE * rng.uniform(-1, 1, 3)
        pose[j, 3:] = start.rpy + fraction * (goal.rpy - start.rpy) + _NOISE * rng.uniform(-1, 1, 3)
        toe[j] = start.toes + fractions[j] * (goal.toes - start.toes)
        toe[j] += _NOISE * rng.uniform(-1, 1, (n, 3))
        force[j, :, 0] = rng.uniform(0.0, 0.5, n * shape.surfaces)
        hold[j] = rng.uniform(0.2, 0.8, n)
    return data.program.formulation.point(
        {
            "pose": pose,
            "toe": toe.reshape(m, -1),
            "force": force.reshape(m, -1),
            "hold": hold,
            "face_weight": 1 / max(shape.faces, 1),
            "s": 0.3,
            **compute_dependent_variables(scene, pose, toe),
        }
    )


def _perturb_rounds(
    data: ComplementarityData,
    footholds: CandidateFootholds,
    v: Array,
    rng: np.random.Generator,
    known_paths: set[bytes],
) -> Array:
    """Perturb a point: some limbs move in other rounds, those that violate their pairs first."""
    shape, scene = data.shape, data.scene
    hold, step = data.value("hold", v), _compute_steps(data, v)
    conflict = (hold * step**2).sum(axis=0) + (hold * (1 - hold)).sum(axis=0)
    main_round = np.argmax(
        (1 - hold) * step, axis=0
    )  # (N,) the round in which each limb moves most
    path = np.full((shape.rounds, shape.limbs), START)
    is_after = np.arange(shape.rounds)[:, None] >= main_round
    path[is_after] = GOAL
    worst = np.argsort(-conflict)[: rng.integers(1, 3)]
    for _ in range(_MAX_DRAWS):
        random_limbs = rng.choice(
            shape.limbs, rng.integers(1, max(2, shape.limbs // 2 + 1)), replace=False
        )
        candidate = path.copy()
        for limb in set(worst) | set(random_limbs) | set(_find_long_steps(scene, candidate)):
            candidate[:, limb] = _draw_path(scene, footholds, int(limb), rng)
        moves = np.diff(np.vstack([np.full(shape.limbs, START), candidate]), axis=0) != 0
        if is_admissible(scene, moves) and moves.tobytes() not in known_paths:
            break
    known_paths.add(moves.tobytes())
    return np.clip(_place_on_path(data, footholds, v, candidate, moves), data.lower, data.upper)


def _find_long_steps(scene: TransitionScene, path: IntArray) -> IntArray:
    """Find limbs that move straight to a goal that is farther than one step."""
    is_far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > compute_step_limits(scene)
    return np.flatnonzero(is_far & (path <= GOAL).all(axis=0))


def _draw_path(
    scene: TransitionScene, footholds: CandidateFootholds, limb: int, rng: np.random.Generator
) -> IntArray:
    """Draw footholds (M,) of a limb after each round: its goal, at once or by an intermediate."""
    m = scene.spec.task.rounds
    path = np.full(m, START)
    intermediate = [c for c in range(2, footholds.count) if footholds.real[limb, c]]
    straight = np.linalg.norm(footholds.toe[limb, GOAL] - footholds.toe[limb, START])
    is_far = straight > compute_step_limits(scene)[limb]
    if intermediate and m > 1 and is_far:
        first, last = np.sort(rng.choice(m, 2, replace=False))
        path[first:] = rng.choice(intermediate)
        path[last:] = GOAL
    else:
        path[rng.integers(m) :] = GOAL
    return path


def _place_on_path(
    data: ComplementarityData,
    footholds: CandidateFootholds,
    v: Array,
    path: IntArray,
    moves: BoolArray,
) -> Array:
    """Place the toes of a point on footholds (M, N); standing limbs press, moving ones do not."""
    shape, formulation = data.shape, data.program.formulation
    limb = np.arange(shape.limbs)
    region = np.vstack([data.scene.start.region, footholds.region[limb, path]])[:-1]
    force = np.zeros((shape.rounds, shape.limbs, shape.surfaces, 3))
    surface_slot = np.argmax(data.surfaces == region[:, :, None], axis=2)
    force[np.arange(shape.rounds)[:, None], limb, surface_slot, 0] = np.where(
        moves, 0.0, _INITIAL_PRESSURE
    )
    point = v.copy()
    toes = footholds.toe[limb, path]
    point[formulation.place("toe")] = toes.reshape(shape.rounds, -1)
    for name, value in compute_dependent_variables(data.scene, data.value("pose", v), toes).items():
        point[formulation.place(name)] = value
    point[formulation.place("hold")] = np.where(moves, 0.05, 0.95)
    point[formulation.place("force")] = force.reshape(shape.rounds, -1)
    return point


def is_admissible(scene: TransitionScene, moves: BoolArray) -> bool:
    """Return whether some limbs move in every round, never too many, and all that have to."""
    max_moving = scene.robot.limb_count - scene.spec.task.min_supporting_limbs
    counts = moves.sum(axis=1)
    must_move = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > _MIN_STEP
    return bool(
        counts.min() > 0 and counts.max() <= max_moving and (moves.any(axis=0) >= must_move).all()
    )


def _compute_steps(data: ComplementarityData, v: Array) -> Array:
    """Compute toe steps (M, N) [m]."""
    toes = np.concatenate([data.scene.start.toes[None], data.value("toe", v)])
    return np.asarray(np.linalg.norm(np.diff(toes, axis=0), axis=-1))


def extract_sequence(data: ComplementarityData, v: Array) -> tuple[SearchTables, ContactSequence]:
    """Extract the contact sequence of a complementary point, with tables of its footholds."""
    scene, m = data.scene, data.shape.rounds
    moves = (data.value("hold", v) < 0.5) & (_compute_steps(data, v) > _MIN_STEP)
    pose = np.vstack([data.value("pose", v), np.append(scene.goal.com, scene.goal.rpy)])
    toes = np.concatenate([scene.start.toes[None], data.value("toe", v)])  # (M + 1, N, 3)
    tables = _build_tables(scene, toes, CandidateBodyPoses(pose[:, :3], pose[:, 3:]), data.surfaces)
    return tables, ContactSequence(_build_states(moves), tuple(range(m + 1)), 0.0, np.inf)


def _build_tables(
    scene: TransitionScene, toes: Array, poses: CandidateBodyPoses, surfaces: IntArray
) -> SearchTables:
    """Build tables: footholds at start, goal, and after each round, on their nearest surfaces."""
    m, n = len(toes) - 1, toes.shape[1]
    toe = np.concatenate([toes[:1], toes[-1:], toes[1:-1]]).swapaxes(0, 1)
    toe[:, GOAL] = scene.goal.toes
    region = np.empty((n, m + 1), np.int64)
    region[:, START], region[:, GOAL] = scene.start.region, scene.goal.region
    for i in range(n):
        for c in range(2, m + 1):
            distance = [scene.terrain.surfaces[s].distance(toe[i, c]) for s in surfaces[i]]
            region[i, c] = surfaces[i][int(np.argmin(distance))]
            toe[i, c] = scene.terrain.surfaces[region[i, c]].project(toe[i, c])
    normal, mu = np.empty_like(toe), np.empty(region.shape)
    for index, surface in enumerate(scene.terrain.surfaces):
        normal[region == index] = surface.normal_at(toe[region == index])
        mu[region == index] = surface.friction
    holds = CandidateFootholds(toe, region, normal, mu, np.ones((n, m + 1), bool))
    return SearchTables(scene, holds, poses, compute_reach(scene, holds, poses))


def _build_states(moves: BoolArray) -> tuple[State, ...]:
    """Foothold indices after each round: a limb's last move takes it to its goal."""
    m, n = moves.shape
    states = np.full((m + 1, n), START)
    for j in range(m):
        for i in range(n):
            is_last_move = not moves[j + 1 :, i].any()
            states[j + 1, i] = (GOAL if is_last_move else 2 + j) if moves[j, i] else states[j, i]
    return tuple(tuple(int(x) for x in row) for row in states)
