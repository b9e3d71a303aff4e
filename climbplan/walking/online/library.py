"""A library of sections cut from solved walks: the source of integers for the online controller.

Published methods and values are those of X. Lin (UCLA 2022).
"""

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
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_datasets, write_text
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.online.features import (
    build_mirror_matrix,
    compute_features,
    feature_count,
)
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.problem.problem import compute_ground_height
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
_MAX_SEARCH_TIME = 60.0  # [s] for one walk
_INITIAL_GAITS = ("trot", "walking trot", "slow trot", "stand")  # first candidates of the search
SECTION = 5  # intervals of a section
# K sections of M samples (one more than intervals), F features, L legs
_LAYOUT = {
    "features": DatasetLayout(("K", "F")),
    "state": DatasetLayout(
        ("K", "M", STATE), "m, m/s, rad, rad/s", "world, from the first position"
    ),
    "toes": DatasetLayout(("K", "M", "L", 3), "m", "world, from the first position"),
    "force": DatasetLayout(("K", "M", "L", 3), "N", "world"),
    "contact": DatasetLayout(("K", "M", "L"), kind="bool"),
    "walk": DatasetLayout(("K",), kind="int"),
}


@dataclass(frozen=True)
class SectionLibrary:
    """K sections of M = `SECTION` intervals, with the features of their first knots."""

    features: Array  # (K, F)
    state: Array  # (K, M + 1, 12) horizontal positions relative to the first knot
    toes: Array  # (K, M + 1, L, 3) likewise relative
    force: Array  # (K, M + 1, L, 3)
    contact: BoolArray  # (K, M + 1, L)
    walk: IntArray  # (K,) walk of origin

    @property
    def walks(self) -> int:
        """Number of walks with sections."""
        return len(np.unique(self.walk))

    def __len__(self) -> int:
        return len(self.features)

    def select_walks(self, walks: int) -> SectionLibrary:
        """Return the sections of the first walks only."""
        selected = self.walk < walks
        return SectionLibrary(*(value[selected] for value in vars(self).values()))


@dataclass(frozen=True)
class LibraryStartRanges:
    """Ranges of random starts: the published one of the forward speed, and disturbances."""

    forward: float = 1.5  # [m/s] either way
    sideways: float = 0.5  # [m/s]
    tilt: float = 0.1  # [rad]
    spin: float = 0.6  # [rad/s]
    toes: float = 0.04  # [m]


def sample_task(task: WalkTask, rng: np.random.Generator, ranges: LibraryStartRanges) -> WalkTask:
    """Return the task from a random start on flat ground."""
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
) -> SectionLibrary:
    """Solve a task from random starts and cut the walks into sections.

    A start without a feasible walk counts as a walk without sections. Mirrored sections are added
    where the task is symmetric.

    Args:
        task: the walking task.
        walks: number of starts.
        seed: of the starts.
        gaits: candidates of the search for each start.
        report: receives the fraction that is done.
        deadline: of `time.monotonic` [s].

    Raises:
        LimitReached: the deadline came before the last walk.
    """
    libraries: list[SectionLibrary] = []
    for k in range(walks):
        if time.monotonic() > deadline:
            raise LimitReached(
                f"solver.time_limit ended the run after {k} of {walks} walks of its library; "
                "`gen-data` solves many, and goes on where it was stopped: library.file takes them"
            )
        rng = np.random.default_rng([seed, k])
        sampled = sample_task(task, rng, LibraryStartRanges())
        seconds = min(_MAX_SEARCH_TIME, deadline - time.monotonic())
        answer = search(sampled, SearchLimits(seconds, gaits, seed, _INITIAL_GAITS))
        if answer.trajectory is not None:
            libraries.append(cut_sections(sampled, answer.trajectory, k))
        if report is not None:
            report((k + 1) / walks)
    if not libraries:
        return _build_empty_library(task.body.leg_count)
    library = merge_libraries(libraries)
    return (
        merge_libraries([library, mirror_library(task, library)]) if is_symmetric(task) else library
    )


def cut_sections(task: WalkTask, trajectory: WalkTrajectory, walk: int) -> SectionLibrary:
    """Cut a walk into all runs of `SECTION` knots.

    Heights are above the terrain under the next knot of the reference, as in a tick.

    Args:
        task: the walk's task.
        trajectory: the walk.
        walk: its number in the library.
    """
    clearance, terrain_height = _compute_heights(task, trajectory)
    sections: list[tuple[Any, ...]] = []
    for n in range(task.knots - SECTION + 1):
        previous = max(n - 1, 0)
        measurement = TickInput(
            trajectory.state[n],
            _project_to_ground(trajectory.toes[n]),
            _project_to_ground(trajectory.toes[previous]),
            trajectory.gait.contact[previous] if n else np.ones_like(trajectory.gait.contact[0]),
        )
        knots = slice(n, n + SECTION + 1)
        base = np.array([*trajectory.state[n, :2], terrain_height[n]])
        state, toes = trajectory.state[knots].copy(), trajectory.toes[knots] - base
        state[:, POSITION] -= base
        features = compute_features(
            measurement, clearance + terrain_height[n], task.reference.velocity[n]
        )
        sections.append(
            (features, state, toes, trajectory.force[knots], trajectory.gait.contact[knots])
        )
    columns = [np.stack(column) for column in zip(*sections, strict=True)]
    features, state, toes, force, contact = columns
    walk_index = np.full(len(sections), walk, np.int64)
    return SectionLibrary(features, state, toes, force, contact.astype(bool), walk_index)


def _compute_heights(task: WalkTask, trajectory: WalkTrajectory) -> tuple[float, Array]:
    """Return the reference's height above the terrain, and terrain heights (N + 1,) at knots."""
    reference, ground = task.reference, task.ground
    if ground.is_flat_everywhere:
        return float(reference.height[0]), np.zeros(len(trajectory.state))
    ahead = trajectory.state[:, :2] + task.dt * reference.velocity[0, :2]
    terrain_height = compute_ground_height(ground, task.body, ahead, reference.euler[0])
    start = task.start.state[None, :2] + task.steps[0] * reference.velocity[0, :2]
    start_height = compute_ground_height(ground, task.body, start, reference.euler[0])
    return float(reference.height[0] - start_height[0]), terrain_height


def is_symmetric(task: WalkTask) -> bool:
    """Return whether the mirror image of a walk solves the same task."""
    reference, center = task.reference, task.body.toe_center
    inertia = task.body.inertia
    same_legs = np.allclose(center[mirror_legs(len(center))] * MIRROR_POINT, center)
    sideways = np.abs(reference.velocity[:, 1]).max() + np.abs(reference.euler[:, [0, 2]]).max()
    return bool(same_legs and sideways < 1e-9 and abs(inertia[0, 1]) + abs(inertia[1, 2]) < 1e-9)


def mirror_library(task: WalkTask, library: SectionLibrary) -> SectionLibrary:
    """Return the sections with left and right exchanged."""
    state = library.state.copy()
    state[..., POSITION] *= MIRROR_POINT
    state[..., VELOCITY] *= MIRROR_POINT
    state[..., ANGLES] *= MIRROR_TURN
    state[..., SPIN] *= MIRROR_TURN
    legs = task.body.leg_count
    leg_order = mirror_legs(legs)
    toes = library.toes[:, :, leg_order] * MIRROR_POINT
    force = library.force[:, :, leg_order] * MIRROR_POINT
    features = library.features @ build_mirror_matrix(legs).T
    contact = library.contact[:, :, leg_order]
    return SectionLibrary(features, state, toes, force, contact, library.walk)


def write_library(library: SectionLibrary, path: Path, key: str) -> None:
    """Write a library as plain arrays; key: of the task that it was built for."""
    with create_store(path) as file:
        write_text(file, "format", FORMAT)
        write_text(file, "task", key)
        write_datasets(file, _LAYOUT, vars(library))


def read_library(path: Path, key: str) -> SectionLibrary:
    """Read a library of the task with a key.

    Raises:
        PlanFileError: a damaged file.
        UsageError: a library of another task.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        if not reader.has_attribute("", "format") or reader.text("", "format") != FORMAT:
            raise reader.refuse("no library of walks")
        datasets = reader.datasets("", _LAYOUT)
        if reader.not_finite:
            raise reader.refuse(f"NaN or infinity in {', '.join(reader.not_finite)}")
        if (
            datasets["features"].shape[1] != feature_count(datasets["contact"].shape[2])
            or datasets["state"].shape[1] != SECTION + 1
        ):
            raise reader.refuse("its sections are of another shape")
        if reader.text("", "task") != key:
            raise UsageError(f"{path}: made for another robot, reference or weights")
    return SectionLibrary(**datasets)


def merge_libraries(libraries: list[SectionLibrary]) -> SectionLibrary:
    """Return one library of all sections."""
    names = list(vars(libraries[0]))
    return SectionLibrary(
        *(np.concatenate([vars(library)[name] for library in libraries]) for name in names)
    )


def _build_empty_library(legs: int) -> SectionLibrary:
    """Return a library without sections."""
    knots = SECTION + 1
    return SectionLibrary(
        np.zeros((0, feature_count(legs))),
        np.zeros((0, knots, STATE)),
        np.zeros((0, knots, legs, 3)),
        np.zeros((0, knots, legs, 3)),
        np.zeros((0, knots, legs), bool),
        np.zeros(0, np.int64),
    )


def _project_to_ground(toes: Array) -> Array:
    """Return toes (L, 3) projected to height 0."""
    return toes * [1.0, 1.0, 0.0]
