"""`motions`: motions of a dataset by robot and scene, and all measures beside public motions.

A dataset that is still being made is named by the hidden folder of its run (`.NAME.rows`). Public
motions have no contacts: they follow from distance and speed of the feet. The same rule is applied
to the dataset's motions for a second comparison.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from benchmarks.motions.paces import bench_paces
from benchmarks.motions.public import (
    PublicSource,
    list_files,
    read_public_motion,
    read_sources,
)
from benchmarks.motions.simulated import bench_simulated
from climbplan.datasets.motions.rows import LAYOUTS, OBJECTIVE_UNIT
from climbplan.datasets.motions.statistics import count_motions
from climbplan.datasets.shards import ShardStore
from climbplan.errors import UsageError
from climbplan.motions.completion import Completion, complete_motion, read_robot
from climbplan.motions.contact_rule import FootShape, Rule, add_contacts
from climbplan.motions.measure import MEASURES, measure_motion
from climbplan.motions.motion_file import read_motion_file
from climbplan.motions.tracked_motion import TrackedMotion
from climbplan.reading import reading
from climbplan.store.dataset import Dataset, DatasetFrame
from climbplan.store.dataset_file import read_dataset_file
from climbplan.verification.check import Check

_QUICK_COUNT = 3
SAMPLE_COUNT = 20  # motions of the dataset that are measured by the rule, and simulated
_NOTE = "run.json"  # of a run that is going on
_PERCENTILES = (50, 95, 100)
_DERIVED = ("velocity.", "kinematics.")  # of public files, whose links and velocities are ours


@dataclass(frozen=True)
class MeasuredMotion:
    """All measures of one motion."""

    name: str
    seconds: float
    checks: tuple[Check, ...]


def bench_motions(
    quick: bool,
    out: TextIO,
    dataset: str | None,
    public: str | None,
    scenes: str | None,
    count: int | None,
) -> dict[str, Any]:
    """Print rows of a dataset by robot and scene, measures of it and of public motions, and paces.

    Args:
        quick: Whether three motions of each kind are measured.
        out: Stream of the tables.
        dataset: Folder of a dataset, or of a run that is going on; None for none.
        public: YAML file of `public.py`; None for none.
        scenes: Shipped climbs that are timed by their dynamics; None for none.
        count: Motions of each kind, spread evenly; None for all.

    Raises:
        UsageError: None of these is named, or one is not there.
    """
    if dataset is None and public is None and scenes is None:
        raise UsageError("`motions`: expected some of --dataset DIR, --public FILE, --scenes NAMES")
    count = _QUICK_COUNT if quick and count is None else count
    results: dict[str, Any] = {}
    if dataset is not None:
        results["dataset"] = _bench_dataset(Path(dataset), count, out)
    if public is not None:
        path = Path(public)
        results["public"] = [
            _bench_source(source, path.parent, count, out) for source in read_sources(path)
        ]
    if scenes is not None:
        results["paces"] = bench_paces(scenes, quick, out)
    return results


def _bench_dataset(folder: Path, count: int | None, out: TextIO) -> dict[str, Any]:
    """Print and return the rows and measures of a dataset."""
    rows, planned_count = _read_dataset(folder)
    title = f"{rows.count} of {planned_count} rows"
    print(f"motions by robot and scene, {title}", file=out)
    heads = ("rows", "planned", "usable", "motion [s]", "CPU planning [s]", "CPU simulation [s]")
    print(f"{'robot':<16}{'scene':<26}" + "".join(f"{head:>20}" for head in heads), file=out)
    counts = count_motions(rows)
    for entry in counts:
        figures = (entry.rows, entry.planned, entry.usable, f"{entry.seconds:.0f}")
        times = (f"{entry.cpu_planning:.1f}", f"{entry.cpu_simulation:.1f}")
        cells = "".join(f"{cell!s:>20}" for cell in (*figures, *times))
        print(f"{entry.robot:<16}{entry.scene:<26}{cells}", file=out)
    usable = rows.solution["usable"].astype(bool) & rows.feasible
    cpu = rows.solution["cpu_plan"] + rows.solution["cpu_simulation"]
    totals = (rows.count, int(rows.feasible.sum()), int(usable.sum()))
    seconds = f"{rows.objective[usable].sum():.0f}"
    means = [
        f"{rows.solution[n][rows.feasible].mean():.1f}" for n in ("cpu_plan", "cpu_simulation")
    ]
    cells = "".join(f"{cell!s:>20}" for cell in (*totals, seconds, *means))
    print(f"{'all':<16}{'':<2}{'all':<24}{cells}\n", file=out)
    paths = [folder / path for path in rows.solution["motion"][usable]]
    as_stored = [_measure_file(path) for path in _select(paths, count)]
    _print_measures(f"measures of {len(as_stored)} motions of the dataset", as_stored, out)
    fewer = _select(paths, min(count or SAMPLE_COUNT, SAMPLE_COUNT))
    by_rule = [_measure_by_rule(path) for path in fewer]
    title = f"{len(by_rule)} of them, contacts by distance and speed of the feet"
    _print_measures(title, by_rule, out)
    simulated = bench_simulated([path.with_suffix(".h5") for path in fewer], out)
    return {
        "rows": rows.count,
        "planned_rows": planned_count,
        "cpu_hours": float(np.nansum(cpu)) / 3600,
        "counts": [vars(entry) for entry in counts],
        "measures": _summarise(as_stored),
        "measures_by_rule": _summarise(by_rule),
        "simulated": simulated,
    }


def _bench_source(
    source: PublicSource, folder: Path, count: int | None, out: TextIO
) -> dict[str, Any]:
    """Print and return the measures of public motions of one source."""
    robot = read_robot(folder / source.robot)
    completion = Completion(robot=robot, feet=source.feet)
    measured = []
    for path in _select(list_files(source, folder), count):
        motion, _ = complete_motion(read_public_motion(path, source, robot), completion)
        checks = measure_motion(motion, {}, robot)
        read = [check for check in checks if not check.name.startswith(_DERIVED)]
        measured.append(_measure(motion, read))
    title = f"{len(measured)} public motions: {source.name}, {source.source} at {source.commit}"
    _print_measures(title, measured, out)
    return {
        "name": source.name,
        "source": source.source,
        "commit": source.commit,
        "measures": _summarise(measured),
    }


def _read_dataset(folder: Path) -> tuple[Dataset, int]:
    """Return the rows of a dataset, or those made so far of a run, and how many it will have."""
    note = folder / _NOTE
    if not note.exists():
        rows = read_dataset_file(folder / "dataset.h5")
        return rows, rows.count
    with reading(note, "the note of a run in JSON"):
        run = json.loads(note.read_text(encoding="utf-8"))
        problem, spec = run["problem"], run["spec"]
        frame = DatasetFrame(
            kind=problem["kind"],
            problem=problem["name"],
            facts=problem["facts"],
            parameter_names=tuple(problem["parameters"]),
            integer_names=tuple(problem["integers"]),
            layouts=LAYOUTS,
            objective_unit=OBJECTIVE_UNIT,
        )
        total, size = int(spec["count"]), int(spec["shard_size"])
    return ShardStore(folder, frame, run["token"], total, size).read_rows(), total


def _select(paths: list[Path], count: int | None) -> list[Path]:
    """Return so many paths, spread evenly; all of them for None."""
    if count is None or count >= len(paths):
        return paths
    return [paths[k] for k in np.linspace(0, len(paths) - 1, count).astype(int)]


def _measure(motion: TrackedMotion, checks: Iterable[Check]) -> MeasuredMotion:
    return MeasuredMotion(motion.name, float(motion.time[-1]), tuple(checks))


def _measure_file(path: Path) -> MeasuredMotion:
    """Return the measures of a motion file, as it is stored."""
    motion = read_motion_file(path)
    return _measure(motion, measure_motion(motion, {}))


def _measure_by_rule(path: Path) -> MeasuredMotion:
    """Return contact measures of a motion file, by the rule of files without contacts."""
    motion = read_motion_file(path)
    contacts = motion.contacts
    assert contacts is not None
    shapes = {
        motion.body_names[body]: FootShape(offset, float(radius))
        for body, offset, radius in zip(
            contacts.body, contacts.offset, contacts.radius, strict=True
        )
    }
    motion = add_contacts(replace(motion, contacts=None), shapes, Rule())
    checks = measure_motion(motion, {})
    return _measure(motion, [check for check in checks if check.name.startswith("contact.")])


def _list_values(measured: list[MeasuredMotion]) -> Iterator[tuple[str, list[Check]]]:
    """Yield each measure with its results of the motions that have data for it."""
    for name, measure in MEASURES.items():
        results = [
            check
            for motion in measured
            for check in motion.checks
            if check.name == name and (check.judged or not np.isfinite(measure.limit))
        ]
        if results and not all(not check.judged and not check.residual for check in results):
            yield name, results


def _print_measures(title: str, measured: list[MeasuredMotion], out: TextIO) -> None:
    """Print median, 95th percentile and worst of each measure, and how many exceed its limit."""
    seconds = sum(motion.seconds for motion in measured)
    print(f"{title}, {seconds:.0f} s of motion", file=out)
    heads = ("median", "95 %", "worst", "limit", "beyond it")
    print(f"{'measure':<26}" + "".join(f"{head:>12}" for head in heads) + "  unit", file=out)
    for name, checks in _list_values(measured):
        quantiles = np.percentile([check.residual for check in checks], _PERCENTILES)
        limit = MEASURES[name].limit
        beyond = f"{sum(not check.passed for check in checks)} of {len(checks)}"
        cells = [*(f"{value:.3g}" for value in quantiles), f"{limit:.3g}"]
        text = "".join(f"{cell:>12}" for cell in cells)
        print(f"{name:<26}{text}{beyond:>12}  {MEASURES[name].unit}", file=out)
    print(file=out)


def _summarise(measured: list[MeasuredMotion]) -> Mapping[str, Any]:
    """Return the same figures as plain values."""
    return {
        "motions": len(measured),
        "seconds": sum(motion.seconds for motion in measured),
        "by_measure": {
            name: {
                "quantiles": np.percentile([c.residual for c in checks], _PERCENTILES).tolist(),
                "limit": MEASURES[name].limit,
                "beyond": sum(not check.passed for check in checks),
                "judged": len(checks),
            }
            for name, checks in _list_values(measured)
        },
    }
