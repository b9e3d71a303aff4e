"""The complementarity method: a homotopy from a random start, and from others near where it ends.

A homotopy ends at a point where all pairs complement each other, or at one where some do not. From
the latter limbs that are at odds with their pairs, and some by chance, are given other rounds to
move in, and the program is solved again from there. What complements is a contact sequence with
its surfaces. The motion is planned again with that fixed, so that nothing of any tolerance is left
in a plan.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import Array, Index, Mask
from climbplan.climb.transition.complementarity import (
    ComplementarityProgram,
    Shape,
    complementarity_program,
)
from climbplan.climb.transition.complementarity_numbers import (
    numbers_of,
    parts_of,
    row_bounds,
    shape_of,
    surfaces_of,
    variable_bounds,
)
from climbplan.climb.transition.footholds import (
    GOAL,
    START,
    Footholds,
    Poses,
    footholds_of,
    reach_of,
)
from climbplan.climb.transition.pose_ways import Sequence, State
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import toe_step_limits
from climbplan.climb.transition.stances import Laboratory
from climbplan.reformulations.nlp_form import Bounds

PENALTIES = (0.3, 3.0, 30.0)  # weights of the products; the last two from where limbs were moved
_COMPLEMENTS = 2e-3  # largest product of a point that complements
_HOLDS = 1e-5  # largest violation of its rows
_MOVED = 0.02  # [m] a shorter step is none
_NOISE = 0.05  # [m] on random starts
_TRIES = 60  # homotopies of one start
_DRAWS = 50  # of rounds for the limbs until they are new ones
_PRESS = 0.3  # of the weight, from which pressures start

Carry = Callable[[Laboratory, Sequence], str]


@dataclass(frozen=True)
class Start:
    """What became of one random start."""

    seed: int
    reason: str  # why there is no motion, empty if there is one
    tries: int  # homotopies, the first from the random start itself
    complemented: int  # of them ended with all pairs complementing each other
    seconds: float  # with what `carry` took
    iterations: int  # of IPOPT


@dataclass(frozen=True)
class _Problem:
    """One scene's program with all its numbers."""

    scene: TransitionScene
    program: ComplementarityProgram
    surfaces: Index  # (N, S)
    numbers: Array  # the last one is the penalty
    bounds: Bounds
    holds: Footholds  # that moved limbs are put on

    @property
    def shape(self) -> Shape:
        """What the program is built for."""
        return self.program.shape

    def at(self, penalty: float) -> Array:
        """The numbers with a penalty."""
        return np.append(self.numbers[:-1], penalty)


def run_start(scene: TransitionScene, seed: int, carry: Carry, deadline: float = np.inf) -> Start:
    """Homotopies from a random start on until one is carried through.

    carry: called with each contact sequence found until it returns no reason against it. deadline
    in `time.monotonic` seconds.
    """
    begin = time.perf_counter()
    problem = _problem_of(scene)
    rng = np.random.default_rng(seed)
    v = np.clip(_random_start(problem, rng), problem.bounds.lower, problem.bounds.upper)
    drawn: set[bytes] = set()
    carried: set[bytes] = set()
    iterations = complemented = tries = 0
    reason = "no point found at which all pairs complement each other"
    penalties: tuple[float, ...] = PENALTIES
    while tries < _TRIES and time.monotonic() < deadline:
        tries += 1
        v, used, complements = _homotopy(problem, v, penalties, deadline)
        iterations += used
        if complements:
            complemented += 1
            lab, sequence = _rounded(problem, v)
            fresh = sequence.moved.tobytes() not in carried
            carried.add(sequence.moved.tobytes())
            if fresh and _admissible(scene, sequence.moved):
                reason = carry(lab, sequence)
                if not reason:
                    seconds = time.perf_counter() - begin
                    return Start(seed, "", tries, complemented, seconds, iterations)
        v = _moved_elsewhere(problem, v, rng, drawn)
        penalties = PENALTIES[1:]
    seconds = time.perf_counter() - begin
    return Start(seed, reason, tries, complemented, seconds, iterations)


def _problem_of(scene: TransitionScene) -> _Problem:
    surfaces = surfaces_of(scene)
    program = complementarity_program(shape_of(scene, surfaces))
    lower, upper = variable_bounds(scene, program)
    rows = row_bounds(scene, program, surfaces)
    numbers = numbers_of(scene, program, surfaces)
    holds = footholds_of(scene)
    return _Problem(scene, program, surfaces, numbers, Bounds(lower, upper, *rows), holds)


def _homotopy(
    problem: _Problem, v: Array, penalties: tuple[float, ...], deadline: float
) -> tuple[Array, int, bool]:
    """The point where a homotopy ends, IPOPT's iterations, and whether all pairs complement."""
    program, iterations = problem.program, 0
    for penalty in penalties:
        point = program.solver.solve(v, problem.at(penalty), problem.bounds, deadline)
        v = np.clip(point.v, problem.bounds.lower, problem.bounds.upper)
        iterations += point.iterations
    products, rows = (np.array(x).ravel() for x in program.products(v, problem.at(0.0)))
    off = np.maximum(problem.bounds.row_lower - rows, rows - problem.bounds.row_upper).max()
    # NaN is no agreement either.
    return v, iterations, bool(off <= _HOLDS and products.max() <= _COMPLEMENTS)


def _random_start(problem: _Problem, rng: np.random.Generator) -> Array:
    """Poses and toes somewhere on their ways, holds and pressures at random."""
    scene, shape = problem.scene, problem.shape
    n, m = shape.limbs, shape.rounds
    start, goal = scene.start, scene.goal
    out = []
    share = np.sort(rng.uniform(0.0, 1.0, (m + 1, n)), axis=0)[1:, :, None]
    for j in range(m):
        part = j / m
        com = start.com + part * (goal.com - start.com) + _NOISE * rng.uniform(-1, 1, 3)
        rpy = start.rpy + part * (goal.rpy - start.rpy) + _NOISE * rng.uniform(-1, 1, 3)
        toes = start.toes + share[j] * (goal.toes - start.toes)
        toes = toes + _NOISE * rng.uniform(-1, 1, toes.shape)
        force = np.zeros((n * shape.surfaces, 3))
        force[:, 0] = rng.uniform(0.0, 0.5, n * shape.surfaces)
        parts = {
            "pose": np.concatenate([com, rpy]),
            "toe": toes,
            "force": force,
            "hold": rng.uniform(0.2, 0.8, n),
            "side": np.full(n * shape.solids * shape.faces, 1 / max(shape.faces, 1)),
            "s": np.array([0.3]),
        }
        out += [parts[name].ravel() for name in problem.program.variables.names]
    return np.concatenate(out)


def _moved_elsewhere(
    problem: _Problem, v: Array, rng: np.random.Generator, known: set[bytes]
) -> Array:
    """A point like v in which some limbs move in other rounds, those at odds first."""
    shape, scene = problem.shape, problem.scene
    parts = parts_of(problem.program, v)
    hold = np.stack([p["hold"][0] for p in parts])  # (M, N)
    step = _steps(scene, parts)
    odds = (hold * step**2).sum(axis=0) + (hold * (1 - hold)).sum(axis=0)
    own = np.argmax((1 - hold) * step, axis=0)  # (N,) the round in which each limb moves most
    path = np.full((shape.rounds, shape.limbs), START)
    after = np.arange(shape.rounds)[:, None] >= own
    path[after] = GOAL
    worst = np.argsort(-odds)[: rng.integers(1, 3)]
    for _ in range(_DRAWS):
        some = rng.choice(shape.limbs, rng.integers(1, max(2, shape.limbs // 2 + 1)), replace=False)
        drawn = path.copy()
        for limb in set(worst) | set(some) | set(_too_far(problem, drawn)):
            drawn[:, limb] = _random_path(problem, int(limb), rng)
        moved = np.diff(np.vstack([np.full(shape.limbs, START), drawn]), axis=0) != 0
        if _admissible(scene, moved) and moved.tobytes() not in known:
            break
    known.add(moved.tobytes())
    return np.clip(_along(problem, parts, drawn, moved), problem.bounds.lower, problem.bounds.upper)


def _too_far(problem: _Problem, path: Index) -> Index:
    """Limbs whose way goes straight to a goal that is further than one step."""
    scene = problem.scene
    far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > toe_step_limits(scene)
    return np.flatnonzero(far & (path <= GOAL).all(axis=0))


def _random_path(problem: _Problem, limb: int, rng: np.random.Generator) -> Index:
    """Footholds (M,) of a limb after each round: its goal at once, or by one between."""
    m, holds = problem.shape.rounds, problem.holds
    path = np.full(m, START)
    between = [c for c in range(2, holds.count) if holds.real[limb, c]]
    straight = np.linalg.norm(holds.toe[limb, GOAL] - holds.toe[limb, START])
    far = straight > toe_step_limits(problem.scene)[limb]
    if between and m > 1 and far:
        first, last = np.sort(rng.choice(m, 2, replace=False))
        path[first:] = rng.choice(between)
        path[last:] = GOAL
    else:
        path[rng.integers(m) :] = GOAL
    return path


def _along(problem: _Problem, parts: list[dict[str, Array]], path: Index, moved: Mask) -> Array:
    """The point with toes on footholds (M, N), limbs that move not holding, others pressing."""
    shape, scene, holds = problem.shape, problem.scene, problem.holds
    limb = np.arange(shape.limbs)
    toes = holds.toe[limb, path]  # (M, N, 3)
    region = np.concatenate([scene.start.region[None], holds.region[limb, path]])
    out = []
    for j, own in enumerate(parts):
        force = np.zeros((shape.limbs, shape.surfaces, 3))
        first = np.argmax(problem.surfaces == region[j][:, None], axis=1)
        force[limb, first, 0] = np.where(moved[j], 0.0, _PRESS)
        new = {
            "toe": toes[j].ravel(),
            "hold": np.where(moved[j], 0.05, 0.95),
            "force": force.ravel(),
        }
        for name in problem.program.variables.names:
            out.append(new.get(name, own[name].T.ravel()))
    return np.concatenate(out)


def _admissible(scene: TransitionScene, moved: Mask) -> bool:
    """Some limbs move in every round, never too many, and all that have to."""
    most = scene.robot.limb_count - scene.spec.task.supporting
    counts = moved.sum(axis=1)
    far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > _MOVED
    return bool(counts.min() > 0 and counts.max() <= most and (moved.any(axis=0) >= far).all())


def _steps(scene: TransitionScene, parts: list[dict[str, Array]]) -> Array:
    """(M, N) toe steps [m]."""
    toes = np.stack([scene.start.toes, *(p["toe"].T for p in parts)])
    return np.asarray(np.linalg.norm(np.diff(toes, axis=0), axis=-1))


def _rounded(problem: _Problem, v: Array) -> tuple[Laboratory, Sequence]:
    """The contact sequence of a point whose pairs complement each other."""
    scene, m = problem.scene, problem.shape.rounds
    parts = parts_of(problem.program, v)
    hold = np.stack([p["hold"][0] for p in parts])
    moved = (hold < 0.5) & (_steps(scene, parts) > _MOVED)
    poses = Poses(
        np.stack([*(p["pose"][:3, 0] for p in parts), scene.goal.com]),
        np.stack([*(p["pose"][3:, 0] for p in parts), scene.goal.rpy]),
    )
    toes = np.stack([scene.start.toes, *(p["toe"].T for p in parts)])  # (M + 1, N, 3)
    lab = _laboratory(scene, toes, poses, problem.surfaces)
    return lab, Sequence(_states(moved), tuple(range(m + 1)), 0.0, np.inf)


def _laboratory(scene: TransitionScene, toes: Array, poses: Poses, surfaces: Index) -> Laboratory:
    """Footholds start, goal, and one after each round but the last, on their nearest surface."""
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
    holds = Footholds(toe, region, normal, mu, np.ones((n, m + 1), bool))
    return Laboratory(scene, holds, poses, reach_of(scene, holds, poses))


def _states(moved: Mask) -> tuple[State, ...]:
    """Foothold numbers after each round: a limb's last move takes it to its goal."""
    m, n = moved.shape
    states = np.full((m + 1, n), START)
    for j in range(m):
        for i in range(n):
            last = not moved[j + 1 :, i].any()
            states[j + 1, i] = (GOAL if last else 2 + j) if moved[j, i] else states[j, i]
    return tuple(tuple(int(x) for x in row) for row in states)
