"""What the online tables of `mpc` are about: a spec, libraries of some sizes, pushes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.walking.shipped_tasks import shipped
from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.walking.online.closed_loop import LoopScenario
from climbplan.walking.online.controller import OnlineSettings
from climbplan.walking.online.library import SectionLibrary
from climbplan.walking.online.run import (
    build_scenario,
    build_settings,
    compute_library_key,
    load_library,
    read_stored_library,
)
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import WalkTask

SPEC = "mpc_recovery"
PUSHES = ((-1.0, 0.0, 0.0), (-1.5, 0.0, 0.0), (0.0, 0.5, 0.0), (-2.8, 0.0, 0.0))  # [m/s]
SIZES = (110, 330, 1000)  # published numbers of walks
_BUILT, _QUICK_BUILT = 110, 6  # walks that are solved where no file gives them
_TRIALS, _QUICK_TRIALS = 20, 3


@dataclass(frozen=True)
class OnlineOptions:
    """What is asked for."""

    seed: int = 0
    quick: bool = False
    count: int | None = None  # trials of each push
    library: Path | None = None  # library.h5 or dataset.h5
    library_size: int | None = None  # walks; of a file the published sizes that it has if None
    jobs: int = 1
    assignments: tuple[str, ...] = ()  # to keys of the shipped spec

    @property
    def trials(self) -> int:
        """Of each push."""
        if self.count is not None:
            return self.count
        return _QUICK_TRIALS if self.quick else _TRIALS


@dataclass(frozen=True)
class OnlineInputs:
    """Read and built: what the tables run on."""

    spec: MpcSpec
    task: WalkTask
    libraries: tuple[SectionLibrary, ...]  # by size
    settings: OnlineSettings
    world: LoopScenario
    pushes: tuple[Array, ...]


def online_inputs(options: OnlineOptions, report: Callable[[str, float], None]) -> OnlineInputs:
    """Libraries and all else.

    Raises:
        SpecError: assignments that no spec can have.
        UsageError, PlanFileError: a library that cannot be used, or too small a one.
    """
    loaded = shipped(SPEC, *options.assignments)
    spec = loaded.spec
    if spec.solver.method != "online":
        raise UsageError(f"mpc walks {SPEC} online, not by {spec.solver.method!r}")
    if options.trials < 1:
        raise UsageError("--count asks for no walk at all")
    task = build_task(spec, loaded.robot, loaded.source)
    given = spec.loop.pushes != shipped(SPEC).spec.loop.pushes
    pushes = [push.velocity for push in spec.loop.pushes] if given else PUSHES
    return OnlineInputs(
        spec,
        task,
        _libraries(options, spec, task, loaded.directory, report),
        build_settings(spec),
        build_scenario(spec.loop, task),
        tuple(np.array(push, float) for push in pushes),
    )


def _libraries(
    options: OnlineOptions,
    spec: MpcSpec,
    task: WalkTask,
    directory: Path,
    report: Callable[[str, float], None],
) -> tuple[SectionLibrary, ...]:
    """Of one size or several, the smaller ones the first walks of the largest."""
    key, named = compute_library_key(task), options.library
    if named is None and spec.library.file is not None:
        named = directory / spec.library.file
    if named is None:
        walks = options.library_size or (_QUICK_BUILT if options.quick else _BUILT)
        few = spec.library.model_copy(update={"size": walks} | _few_gaits(options))
        return (load_library(task, few, directory, options.seed, key, report),)
    stored = read_stored_library(named, key)
    if options.library_size is not None:
        if stored.walks < options.library_size:
            raise UsageError(
                f"{named}: {stored.walks} walks with sections, "
                f"--library-size asks for {options.library_size}"
            )
        return (stored.select_walks(options.library_size),)
    sizes = [size for size in SIZES if size <= stored.walks] or [stored.walks]
    return tuple(stored.select_walks(size) for size in sizes)


def _few_gaits(options: OnlineOptions) -> dict[str, int]:
    return {"gaits": 0} if options.quick else {}


def in_words(push: Array) -> str:
    """A push for tables."""
    ways = (("back", "on"), ("aside", "aside"), ("down", "up"))
    parts = [
        f"{words[int(value > 0)]} {abs(value):g}"
        for value, words in zip(push.tolist(), ways, strict=True)
        if value
    ]
    return ", ".join(parts) + " m/s" if parts else "none"
