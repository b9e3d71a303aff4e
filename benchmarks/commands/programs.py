"""Benchmarks of solvers of mixed-integer programs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from benchmarks.running import Results, Run, Seed, benchmark, name_option, number_option


@benchmark()
def instances(
    run: Run,
    seed: Seed = 0,
    out: Results = None,
    count: Annotated[
        int | None, number_option("--count", "Instances of each family and class [9; quick 1].")
    ] = None,
    time_limit: Annotated[
        float | None, number_option("--time-limit", "Of one instance [s] [10; quick 2].", 0.1)
    ] = None,
    methods: Annotated[
        str | None, name_option("--methods", "NAMES", "Solvers, by commas [all].")
    ] = None,
) -> None:
    """SCIP, HiGHS, Bonmin and the own tree on the public set of contact problems."""
    from benchmarks.instances.run import bench_instances

    bench_instances(seed, run.quick, run.stream, out, count, time_limit, methods)


@benchmark()
def engine(run: Run, seed: Seed = 0) -> None:
    """The own trees, cold and remembering, beside DAQP, HiGHS, SCIP; walls, products."""
    from benchmarks.engine.run import run_engine

    run_engine(seed, run.quick, run.stream)


@benchmark()
def learned(
    run: Run,
    seed: Seed = 0,
    solved: Annotated[
        int | None, number_option("--solved", "Problems to learn from [200; quick 8].", 2)
    ] = None,
    count: Annotated[
        int | None, number_option("--count", "New problems to compare by [20; quick 2].")
    ] = None,
    sorts: Annotated[
        str | None, name_option("--sorts", "NAMES", "Sorts of problems, by commas [all].")
    ] = None,
) -> Mapping[str, Any]:
    """Learned strategies against the default method, with a proof and alone."""
    from benchmarks.engine.learned import run_learned

    return run_learned(
        seed,
        run.quick,
        run.stream,
        solved=solved,
        compared=count,
        sorts=sorts,
        report=run.report,
    )


@benchmark()
def conic(run: Run, seed: Seed = 0) -> None:
    """Problems with integers through CVXPY: random ones, footsteps, graphs of convex sets."""
    from benchmarks.engine.conic import run_conic

    run_conic(seed, run.quick, run.stream)


@benchmark()
def qplib(
    run: Run,
    folder: Annotated[Path, name_option("--folder", "DIR", "Folder of .qplib files.")] = Path(
        "qplib"
    ),
    out: Results = None,
    time_limit: Annotated[
        float | None, number_option("--time-limit", "Of one instance [s] [60; quick 2].", 0.1)
    ] = None,
) -> None:
    """Instances of QPLIB by the own trees, SCIP and HiGHS."""
    from benchmarks.engine.qplib import run_qplib

    run_qplib(run.quick, run.stream, folder, out, time_limit)


@benchmark()
def startup(
    run: Run,
    python: Annotated[
        str | None,
        name_option("--python", "FILES", "Interpreters to measure, by commas [this one]."),
    ] = None,
) -> Mapping[str, Any]:
    """Commands on a machine that has compiled nothing yet, and their second run."""
    from benchmarks.engine.startup import run_startup

    return {"startup": run_startup(run.quick, run.stream, (python or sys.executable).split(","))}
