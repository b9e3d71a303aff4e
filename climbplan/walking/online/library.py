"""Solved walks cut into short sections: what the online controller takes its integers from."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import LimitReached, UsageError
from climbplan.robots.leg_order import MIRROR_POINT, MIRROR_TURN, mirror_legs
from climbplan.store.hdf5_layout import Layout
from climbplan.store.hdf5_reading import Reader, opened_store
from climbplan.store.hdf5_writing import new_store, write_datasets, write_text
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.online.features import (
    feature_count,
    feature_mirror,
    features_of,
)
from climbplan.walking.online.measurement import Situation
from climbplan.walking.problem.problem import ground_under
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Start,
    WalkTask,
    WalkTrajectory,
)

FORMAT = "climbplan/walk-library"
_LONGEST = 60.0  # [s] of the search for one walk
_NAMES = ("trot", "walking trot", "slow trot", "stand")  # gaits to begin with
SECTION = 5  # knots of a section: 400 ms
# K sections of M knots, F features, L legs
_LAYOUT = {
    "features": Layout(("K", "F")),
    "state": Layout(("K", "M", STATE), "m, m/s, rad, rad/s", "world, from the first position"),
    "toes": Layout(("K", "M", "L", 3), "m", "world, from the first position"),
    "force": Layout(("K", "M", "L", 3), "N", "world"),
    "contact": Layout(("K", "M", "L"), kind="bool"),
    "walk": Layout(("K",), kind="int"),
}


@dataclass(frozen=True)
class Library:
    """K sections with the features of their first knots."""

    features: Array  # (K, F)
    state: Array  # (K, M + 1, 12) horizontal positions from the first
    toes: Array  # (K, M + 1, L, 3) the same
    force: Array  # (K, M + 1, L, 3)
    contact: BoolArray  # (K, M + 1, L)
    walk: IntArray  # (K,) the walk it was cut from

    @property
    def walks(self) -> int:
        """Stored trajectories."""
        return len(np.unique(self.walk))

    def __len__(self) -> int:
        return len(self.features)

    def first(self, walks: int) -> Library:
        """Only the sections of so many walks."""
        kept = self.walk < walks
        return Library(*(value[kept] for value in vars(self).values()))


@dataclass(frozen=True)
class Draw:
    """Ranges of random starts: the published one of the forward speed, and disturbances."""

    forward: float = 1.5  # [m/s] either way
    sideways: float = 0.5  # [m/s]
    tilt: float = 0.1  # [rad]
    spin: float = 0.6  # [rad/s]
    toes: float = 0.04  # [m]


def drawn_task(task: WalkTask, rng: np.random.Generator, ranges: Draw) -> WalkTask:
    """The task from a random start on flat ground."""
    state = task.start.state.copy()
    state[VELOCITY] += [
        rng.uniform(-ranges.forward, ranges.forward),
        rng.uniform(-ranges.sideways, ranges.sideways),
        0.0,
    ]
    state[VELOCITY] -= task.start.state[VELOCITY]
    state[6:8] += rng.uniform(-ranges.tilt, ranges.tilt, 2)
    state[SPIN] += rng.uniform(-ranges.spin, ranges.spin, 3)
    toes = task.start.toes.copy()
    toes[:, :2] += rng.uniform(-ranges.toes, ranges.toes, (len(toes), 2))
    return replace(task, start=Start(state, toes))


def build_library(
    task: WalkTask,
    walks: int,
    seed: int,
    gaits: int = 20,
    report: Callable[[float], None] | None = None,
    deadline: float = math.inf,
) -> Library:
    """Solve so many random starts of a task and cut the walks into sections.

    A start that no gait answers counts as a walk without sections. Mirrored sections are added
    where the task is the same in a mirror. Raises LimitReached at a deadline of `time.monotonic`.
    """
    parts: list[Library] = []
    for k in range(walks):
        if time.monotonic() > deadline:
            raise LimitReached(
                f"solver.time_limit ended the run after {k} of {walks} walks of its library; "
                "`gen-data` solves many, and goes on where it was stopped: library.file takes them"
            )
        rng = np.random.default_rng([seed, k])
        drawn = drawn_task(task, rng, Draw())
        seconds = min(_LONGEST, deadline - time.monotonic())
        answer = search(drawn, SearchLimits(seconds, gaits, seed, _NAMES))
        if answer.trajectory is not None:
            parts.append(sections_of(drawn, answer.trajectory, k))
        if report is not None:
            report((k + 1) / walks)
    if not parts:
        return _empty(task.body.leg_count)
    whole = joined(parts)
    return joined([whole, mirrored(task, whole)]) if symmetric(task) else whole


def sections_of(task: WalkTask, found: WalkTrajectory, walk: int) -> Library:
    """Every run of `SECTION` knots of a walk, with heights above the ground that it is to walk on.

    That is the ground under the next knot of its reference, as a tick has it.
    """
    above, under = _heights(task, found)
    rows: list[tuple[Any, ...]] = []
    for n in range(task.knots - SECTION + 1):
        before = max(n - 1, 0)
        situation = Situation(
            found.state[n],
            _grounded(found.toes[n]),
            _grounded(found.toes[before]),
            found.gait.contact[before] if n else np.ones_like(found.gait.contact[0]),
        )
        here = slice(n, n + SECTION + 1)
        base = np.array([*found.state[n, :2], under[n]])
        state, toes = found.state[here].copy(), found.toes[here] - base
        state[:, POSITION] -= base
        features = features_of(situation, above + under[n], task.reference.velocity[n])
        rows.append((features, state, toes, found.force[here], found.gait.contact[here]))
    columns = [np.stack(column) for column in zip(*rows, strict=True)]
    features, state, toes, force, contact = columns
    number = np.full(len(rows), walk, np.int64)
    return Library(features, state, toes, force, contact.astype(bool), number)


def _heights(task: WalkTask, found: WalkTrajectory) -> tuple[float, Array]:
    """Height of the reference above the ground, and of the ground (N + 1,) ahead of each knot."""
    reference, ground = task.reference, task.ground
    if ground.endless:
        return float(reference.height[0]), np.zeros(len(found.state))
    ahead = found.state[:, :2] + task.step * reference.velocity[0, :2]
    under = ground_under(ground, task.body, ahead, reference.euler[0])
    start = task.start.state[None, :2] + task.steps[0] * reference.velocity[0, :2]
    first = ground_under(ground, task.body, start, reference.euler[0])
    return float(reference.height[0] - first[0]), under


def symmetric(task: WalkTask) -> bool:
    """Whether a walk seen in a mirror answers the same task."""
    reference, center = task.reference, task.body.toe_center
    inertia = task.body.inertia
    same_legs = np.allclose(center[mirror_legs(len(center))] * MIRROR_POINT, center)
    sideways = np.abs(reference.velocity[:, 1]).max() + np.abs(reference.euler[:, [0, 2]]).max()
    return bool(same_legs and sideways < 1e-9 and abs(inertia[0, 1]) + abs(inertia[1, 2]) < 1e-9)


def mirrored(task: WalkTask, library: Library) -> Library:
    """The same sections with left and right exchanged."""
    state = library.state.copy()
    state[..., POSITION] *= MIRROR_POINT
    state[..., VELOCITY] *= MIRROR_POINT
    state[..., ANGLES] *= MIRROR_TURN
    state[..., SPIN] *= MIRROR_TURN
    legs = task.body.leg_count
    other = mirror_legs(legs)
    toes = library.toes[:, :, other] * MIRROR_POINT
    force = library.force[:, :, other] * MIRROR_POINT
    features = library.features @ feature_mirror(legs).T
    contact = library.contact[:, :, other]
    return Library(features, state, toes, force, contact, library.walk)


def write_library(library: Library, path: Path, key: str) -> None:
    """Write a library of plain arrays; key: of the task it was made for."""
    with new_store(path) as file:
        write_text(file, "format", FORMAT)
        write_text(file, "task", key)
        write_datasets(file, _LAYOUT, vars(library))


def read_library(path: Path, key: str) -> Library:
    """A library of the task with this key.

    Raises PlanFileError for a damaged file, UsageError for one of another task.
    """
    with opened_store(path) as file:
        reader = Reader(path, file)
        if not reader.has_attribute("", "format") or reader.text("", "format") != FORMAT:
            raise reader.refuse("no library of walks")
        parts = reader.datasets("", _LAYOUT)
        if reader.not_finite:
            raise reader.refuse(f"NaN or infinity in {', '.join(reader.not_finite)}")
        if (
            parts["features"].shape[1] != feature_count(parts["contact"].shape[2])
            or parts["state"].shape[1] != SECTION + 1
        ):
            raise reader.refuse("its sections are of another shape")
        if reader.text("", "task") != key:
            raise UsageError(f"{path}: made for another robot, reference or weights")
    return Library(**parts)


def joined(parts: list[Library]) -> Library:
    """All sections of some libraries."""
    names = list(vars(parts[0]))
    return Library(*(np.concatenate([vars(part)[name] for part in parts]) for name in names))


def _empty(legs: int) -> Library:
    knots = SECTION + 1
    return Library(
        np.zeros((0, feature_count(legs))),
        np.zeros((0, knots, STATE)),
        np.zeros((0, knots, legs, 3)),
        np.zeros((0, knots, legs, 3)),
        np.zeros((0, knots, legs), bool),
        np.zeros(0, np.int64),
    )


def _grounded(toes: Array) -> Array:
    """Toes (L, 3) where they are to stand."""
    return toes * [1.0, 1.0, 0.0]
