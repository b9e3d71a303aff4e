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

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.transition.complementarity_numbers import FreeMotion, found_at, free_motion
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

PENALTIES = (0.3, 3.0, 30.0)  # weights of the products; the last two from where limbs were moved
_HOLDS = 1e-5  # largest violation of the rows of a point that complements
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


def run_start(scene: TransitionScene, seed: int, carry: Carry, deadline: float = np.inf) -> Start:
    """Homotopies from a random start on until one is carried through.

    carry: called with each contact sequence found until it returns no reason against it. deadline
    in `time.monotonic` seconds.
    """
    begin = time.perf_counter()
    motion, holds = free_motion(scene), footholds_of(scene)
    rng = np.random.default_rng(seed)
    v = np.clip(_random_start(motion, rng), motion.lower, motion.upper)
    drawn: set[bytes] = set()
    carried: set[bytes] = set()
    iterations = complemented = tries = 0
    reason = "no point found at which all pairs complement each other"
    penalties: tuple[float, ...] = PENALTIES
    while tries < _TRIES and time.monotonic() < deadline:
        tries += 1
        v, used, good = _homotopy(motion, v, penalties, deadline)
        iterations += used
        if good:
            complemented += 1
            lab, sequence = sequence_at(motion, v)
            fresh = sequence.moved.tobytes() not in carried
            carried.add(sequence.moved.tobytes())
            if fresh and admissible(scene, sequence.moved):
                reason = carry(lab, sequence)
                if not reason:
                    seconds = time.perf_counter() - begin
                    return Start(seed, "", tries, complemented, seconds, iterations)
        v = _moved_elsewhere(motion, holds, v, rng, drawn)
        penalties = PENALTIES[1:]
    seconds = time.perf_counter() - begin
    return Start(seed, reason, tries, complemented, seconds, iterations)


def _homotopy(
    motion: FreeMotion, v: Array, penalties: tuple[float, ...], deadline: float
) -> tuple[Array, int, bool]:
    """The point where a homotopy ends, IPOPT's iterations, and whether all pairs complement."""
    program, iterations = motion.program.penalised, 0
    bounds = motion.bounds(program.stated)
    for penalty in penalties:
        p = program.stated.theta(motion.parameters | {"penalty": penalty})
        point = program.solver.solve(v, p, bounds, deadline)
        v = np.clip(point.v, motion.lower, motion.upper)
        iterations += point.iterations
    return v, iterations, complements(motion, v)


def complements(motion: FreeMotion, v: Array) -> bool:
    """Whether all pairs of a point complement each other and all other rows hold."""
    stated = motion.program.stated
    rows = np.array(motion.program.rows(v, stated.theta(motion.parameters))).ravel()
    bounds = motion.bounds(stated)
    found = stated.residuals(rows, (bounds.row_lower, bounds.row_upper))
    return all(block.residual <= _HOLDS for block in found)


def _random_start(motion: FreeMotion, rng: np.random.Generator) -> Array:
    """Poses and toes somewhere on their ways, holds and pressures at random."""
    scene, shape = motion.scene, motion.shape
    n, m = shape.limbs, shape.rounds
    start, goal = scene.start, scene.goal
    share = np.sort(rng.uniform(0.0, 1.0, (m + 1, n)), axis=0)[1:, :, None]
    pose, toe = np.empty((m, 6)), np.empty((m, n, 3))
    force, hold = np.zeros((m, n * shape.surfaces, 3)), np.empty((m, n))
    for j in range(m):
        part = j / m
        pose[j, :3] = start.com + part * (goal.com - start.com) + _NOISE * rng.uniform(-1, 1, 3)
        pose[j, 3:] = start.rpy + part * (goal.rpy - start.rpy) + _NOISE * rng.uniform(-1, 1, 3)
        toe[j] = start.toes + share[j] * (goal.toes - start.toes)
        toe[j] += _NOISE * rng.uniform(-1, 1, (n, 3))
        force[j, :, 0] = rng.uniform(0.0, 0.5, n * shape.surfaces)
        hold[j] = rng.uniform(0.2, 0.8, n)
    return motion.program.stated.point(
        {
            "pose": pose,
            "toe": toe.reshape(m, -1),
            "force": force.reshape(m, -1),
            "hold": hold,
            "face_weight": 1 / max(shape.faces, 1),
            "s": 0.3,
            **found_at(scene, pose, toe),
        }
    )


def _moved_elsewhere(
    motion: FreeMotion, holds: Footholds, v: Array, rng: np.random.Generator, known: set[bytes]
) -> Array:
    """A point like v in which some limbs move in other rounds, those at odds first."""
    shape, scene = motion.shape, motion.scene
    hold, step = motion.value("hold", v), _steps(motion, v)
    odds = (hold * step**2).sum(axis=0) + (hold * (1 - hold)).sum(axis=0)
    own = np.argmax((1 - hold) * step, axis=0)  # (N,) the round in which each limb moves most
    path = np.full((shape.rounds, shape.limbs), START)
    after = np.arange(shape.rounds)[:, None] >= own
    path[after] = GOAL
    worst = np.argsort(-odds)[: rng.integers(1, 3)]
    for _ in range(_DRAWS):
        some = rng.choice(shape.limbs, rng.integers(1, max(2, shape.limbs // 2 + 1)), replace=False)
        drawn = path.copy()
        for limb in set(worst) | set(some) | set(_too_far(scene, drawn)):
            drawn[:, limb] = _random_path(scene, holds, int(limb), rng)
        moved = np.diff(np.vstack([np.full(shape.limbs, START), drawn]), axis=0) != 0
        if admissible(scene, moved) and moved.tobytes() not in known:
            break
    known.add(moved.tobytes())
    return np.clip(_along(motion, holds, v, drawn, moved), motion.lower, motion.upper)


def _too_far(scene: TransitionScene, path: IntArray) -> IntArray:
    """Limbs whose way goes straight to a goal that is further than one step."""
    far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > toe_step_limits(scene)
    return np.flatnonzero(far & (path <= GOAL).all(axis=0))


def _random_path(
    scene: TransitionScene, holds: Footholds, limb: int, rng: np.random.Generator
) -> IntArray:
    """Footholds (M,) of a limb after each round: its goal at once, or by one between."""
    m = scene.spec.task.rounds
    path = np.full(m, START)
    between = [c for c in range(2, holds.count) if holds.real[limb, c]]
    straight = np.linalg.norm(holds.toe[limb, GOAL] - holds.toe[limb, START])
    far = straight > toe_step_limits(scene)[limb]
    if between and m > 1 and far:
        first, last = np.sort(rng.choice(m, 2, replace=False))
        path[first:] = rng.choice(between)
        path[last:] = GOAL
    else:
        path[rng.integers(m) :] = GOAL
    return path


def _along(
    motion: FreeMotion, holds: Footholds, v: Array, path: IntArray, moved: BoolArray
) -> Array:
    """v with toes on footholds (M, N), limbs that move not holding, others pressing."""
    shape, stated = motion.shape, motion.program.stated
    limb = np.arange(shape.limbs)
    region = np.vstack([motion.scene.start.region, holds.region[limb, path]])[:-1]
    force = np.zeros((shape.rounds, shape.limbs, shape.surfaces, 3))
    first = np.argmax(motion.surfaces == region[:, :, None], axis=2)
    force[np.arange(shape.rounds)[:, None], limb, first, 0] = np.where(moved, 0.0, _PRESS)
    out = v.copy()
    toes = holds.toe[limb, path]
    out[stated.place("toe")] = toes.reshape(shape.rounds, -1)
    for name, value in found_at(motion.scene, motion.value("pose", v), toes).items():
        out[stated.place(name)] = value
    out[stated.place("hold")] = np.where(moved, 0.05, 0.95)
    out[stated.place("force")] = force.reshape(shape.rounds, -1)
    return out


def admissible(scene: TransitionScene, moved: BoolArray) -> bool:
    """Some limbs move in every round, never too many, and all that have to."""
    most = scene.robot.limb_count - scene.spec.task.supporting
    counts = moved.sum(axis=1)
    far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > _MOVED
    return bool(counts.min() > 0 and counts.max() <= most and (moved.any(axis=0) >= far).all())


def _steps(motion: FreeMotion, v: Array) -> Array:
    """(M, N) toe steps [m]."""
    toes = np.concatenate([motion.scene.start.toes[None], motion.value("toe", v)])
    return np.asarray(np.linalg.norm(np.diff(toes, axis=0), axis=-1))


def sequence_at(motion: FreeMotion, v: Array) -> tuple[Laboratory, Sequence]:
    """The contact sequence of a point whose pairs complement each other, and what it is made of."""
    scene, m = motion.scene, motion.shape.rounds
    moved = (motion.value("hold", v) < 0.5) & (_steps(motion, v) > _MOVED)
    pose = np.vstack([motion.value("pose", v), np.append(scene.goal.com, scene.goal.rpy)])
    toes = np.concatenate([scene.start.toes[None], motion.value("toe", v)])  # (M + 1, N, 3)
    lab = _laboratory(scene, toes, Poses(pose[:, :3], pose[:, 3:]), motion.surfaces)
    return lab, Sequence(_states(moved), tuple(range(m + 1)), 0.0, np.inf)


def _laboratory(
    scene: TransitionScene, toes: Array, poses: Poses, surfaces: IntArray
) -> Laboratory:
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


def _states(moved: BoolArray) -> tuple[State, ...]:
    """Foothold numbers after each round: a limb's last move takes it to its goal."""
    m, n = moved.shape
    states = np.full((m + 1, n), START)
    for j in range(m):
        for i in range(n):
            last = not moved[j + 1 :, i].any()
            states[j + 1, i] = (GOAL if last else 2 + j) if moved[j, i] else states[j, i]
    return tuple(tuple(int(x) for x in row) for row in states)
