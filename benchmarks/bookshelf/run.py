"""`bookshelf`: all methods on the same scenes, published placements beside ours."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TextIO

from benchmarks.bookshelf.contenders import CONTENDERS, MEANINGS, Contender, chosen
from benchmarks.bookshelf.context import NOTES, ROWS
from benchmarks.bookshelf.inputs import Inputs, bench_inputs, in_turn, write_library
from benchmarks.bookshelf.measure import (
    Figures,
    Run,
    figures_of,
    reference,
    run_contender,
)
from benchmarks.bookshelf.published import PublishedReport, compare_published
from benchmarks.bookshelf.table import write_context, write_methods, write_published
from climbplan.arrays import Array
from climbplan.bookshelf.exact.method import ExactLimits
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.bookshelf.schema.model import ShelfSolverSpec
from climbplan.errors import MissingSolver
from climbplan.progress import Progress

_LIBRARY_NAME = "library.h5"


@dataclass(frozen=True)
class BenchOptions:
    """What is compared, and on how much."""

    seed: int = 0
    count: int = 40  # scenes; 0: the published placements only
    some: int = 20  # scenes of the methods that take about a second each
    few: int = 4  # scenes of the slowest ones
    seconds: float = 5.0  # limit of one scene of these
    library_size: int = 1000  # generated scenes
    scenes: str | None = None  # FILE[:GROUP]
    library: Path | None = None  # plan file
    published: str | None = None  # FILE[:GROUP]
    methods: str | None = None  # comma-separated keys


@dataclass(frozen=True)
class BenchResult:
    """Figures of all runs, and what was said about published placements."""

    origin: str  # of scenes and library, in words
    figures: list[Figures] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)
    best: dict[str, Array] = field(default_factory=dict)  # reference costs by meaning
    left_out: list[str] = field(default_factory=list)  # methods, and why
    published: PublishedReport | None = None
    load: float = 0.0  # of the machine at the end


def bench_bookshelf(options: BenchOptions, report: Progress) -> BenchResult:
    """Run all comparisons.

    Raises:
        UsageError, PlanFileError, WrongScenes: options or files that cannot be used.
        MissingSolver: scenes have to be generated, and pymunk is not installed.
    """
    contenders = chosen(options.methods)
    result = BenchResult("")
    if options.count > 0:
        inputs = bench_inputs(options.scenes, options.count, options.seed, report)
        with tempfile.TemporaryDirectory() as folder:
            library, words = options.library, ""
            if any(contender.learns for contender in contenders):
                words = f"; library {library.name if library else ''}"
                if library is None:
                    library = Path(folder, _LIBRARY_NAME)
                    write_library(inputs, options.library_size, options.seed, library, report)
                    words = f"; library of {options.library_size} generated scenes by `exact`"
            result = _compared(inputs, contenders, library, options, report, inputs.origin + words)
    found = None
    if options.published is not None:
        found = compare_published(options.published, ExactLimits(), report)
    return BenchResult(
        result.origin, result.figures, result.runs, result.best, result.left_out, found,
        os.getloadavg()[0],
    )  # fmt: skip


def _compared(
    inputs: Inputs,
    contenders: Sequence[Contender],
    library: Path | None,
    options: BenchOptions,
    report: Progress,
    origin: str,
) -> BenchResult:
    exact = CONTENDERS[0]  # runs in any case, as the reference
    setting = exact.setting(inputs.shelf, "contact", None, options.seconds)
    every = range(len(inputs.scenes))
    first = run_contender(exact, setting, inputs.scenes, every)
    order = in_turn(first.cost, TRIVIAL)
    amount = {"all": len(order), "some": options.some, "few": options.few}
    runs, left_out = [first], []
    for meaning in MEANINGS:
        for contender in contenders:
            if contender is exact or meaning not in contender.meanings:
                continue
            report(f"{contender.key} {meaning}", 0.0)
            rows = sorted(order[: amount[contender.effort]])
            made = contender.setting(inputs.shelf, meaning, library, options.seconds)
            try:
                runs.append(run_contender(contender, made, inputs.scenes, rows))
            except MissingSolver as error:
                left_out.append(f"{contender.label}: {error}")
    best: dict[str, Array] = {m: reference(runs, inputs.scenes, setting, m) for m in MEANINGS}
    limits = ShelfSolverSpec()
    figures = [figures_of(run, best[run.meaning], limits.gap_mm2, limits.gap) for run in runs]
    return BenchResult(origin, figures, runs, best, left_out)


def as_json(result: BenchResult) -> dict[str, Any]:
    """Return all figures as plain values."""
    return {
        "inputs": result.origin,
        "load": result.load,
        "methods": [asdict(row) for row in result.figures],
        "scenes": [
            {
                "method": run.contender.key,
                "meaning": run.meaning,
                "scene": run.scene,
                "cost_mm2": run.cost.tolist(),
                "claimed_bound_mm2": run.claims.tolist(),
                "seconds": [answer.seconds for answer in run.answers],
                "status": [answer.status for answer in run.answers],
                "word": [answer.message for answer in run.answers],
            }
            for run in result.runs
        ],
        "reference_mm2": {meaning: cost.tolist() for meaning, cost in result.best.items()},
        "left_out": result.left_out,
        "published": None if result.published is None else asdict(result.published),
        "published_tables": {"notes": NOTES, "rows": [asdict(row) for row in ROWS]},
    }


def write_text(result: BenchResult, out: TextIO) -> None:
    """All tables."""
    if result.runs:
        out.write(f"bookshelf: {result.origin}; one thread, machine load {result.load:.1f}\n")
        for meaning in MEANINGS:
            write_methods([row for row in result.figures if row.meaning == meaning], meaning, out)
    for line in result.left_out:
        out.write(f"left out: {line}\n")
    if result.published is not None:
        write_published(result.published, out)
    write_context(out)
