"""Benchmarks of climbs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from benchmarks.running import Results, Run, Seed, benchmark, name_option, number_option


@benchmark()
def posture(run: Run, seed: Seed = 0) -> None:
    """Posture planner against SCIP on the same statement."""
    from benchmarks.climb.posture import bench_posture

    bench_posture(seed, run.quick, run.stream)


@benchmark()
def force(run: Run, seed: Seed = 0) -> None:
    """Force planner against CVXPY and Clarabel on the same instants."""
    from benchmarks.climb.force import bench_force

    bench_force(seed, run.quick, run.stream)


@benchmark()
def plan(run: Run, seed: Seed = 0) -> None:
    """The whole decoupled plan: postures, joint angles, forces, checks."""
    from benchmarks.climb.plan import bench_plan

    bench_plan(seed, run.quick, run.stream)


@benchmark()
def coupled(run: Run, seed: Seed = 0) -> None:
    """Positions and forces together: against CVXPY, and on random slippery patches."""
    from benchmarks.climb.coupled import bench_coupled

    bench_coupled(seed, run.quick, run.stream)


@benchmark()
def growth(run: Run, seed: Seed = 0) -> None:
    """Cost over rounds 2 to 32 and limbs 4 to 8."""
    from benchmarks.climb.posture import bench_growth

    bench_growth(seed, run.quick, run.stream)


@benchmark()
def windows(run: Run, seed: Seed = 0) -> None:
    """1,000 regions in windows of rounds, and a rocky tube climbed to its end."""
    from benchmarks.climb.windows import bench_windows

    bench_windows(seed, run.quick, run.stream)


@benchmark()
def transition(run: Run, seed: Seed = 0) -> None:
    """Complementarity from random starts against the search over stance sets."""
    from benchmarks.climb.transition import run_transition

    run_transition(seed, run.quick, run.stream)


@benchmark()
def refusals(
    run: Run,
    seed: Seed = 0,
    count: Annotated[int | None, number_option("--count", "Random climbs [60; quick 6].")] = None,
    time_limit: Annotated[
        float,
        number_option("--time-limit", "Of one climb [s]; ten times that for second tries.", 0.1),
    ] = 20.0,
) -> None:
    """Random climbs: planned, proved impossible or not proved, limits, second tries."""
    from benchmarks.climb.refusals import bench_refusals

    bench_refusals(seed, run.quick, run.stream, count, time_limit)


@benchmark()
def stands(
    run: Run,
    seed: Seed = 0,
    count: Annotated[int | None, number_option("--count", "Random climbs [40; quick 2].")] = None,
) -> None:
    """Shipped and random climbs in MuJoCo, with margins and without."""
    from benchmarks.climb.stands import bench_stands

    bench_stands(seed, run.quick, run.stream, count)


@benchmark()
def judge(
    run: Run,
    seed: Seed = 0,
    count: Annotated[
        int | None, number_option("--count", "Worlds of each scene [16; quick 3].")
    ] = None,
) -> None:
    """The quasi-static engine against MuJoCo in the same worlds of shipped scenes."""
    from benchmarks.climb.judge import bench_judge

    bench_judge(seed, run.quick, run.stream, count)


@benchmark()
def scans(
    run: Run,
    scenes: Annotated[str | None, name_option("--scenes", "DIR", "Folder of meshes [.].")] = None,
) -> None:
    """Meshes of hpp-environments: regions, rounds, verified, standing on the raw mesh."""
    from benchmarks.climb.scans import bench_scans

    bench_scans(run.quick, run.stream, scenes)


@benchmark()
def closed_loop(
    run: Run,
    seed: Seed = 0,
    scenes: Annotated[str | None, name_option("--scenes", "NAMES", "Specs, by commas.")] = None,
    kinds: Annotated[
        str | None, name_option("--kinds", "NAMES", "Of worlds, by commas: drawn, 2 kg more, ...")
    ] = None,
    count: Annotated[int | None, number_option("--count", "Drawn worlds of each [20].")] = None,
    out: Results = None,
) -> Mapping[str, Any]:
    """Climbs in worlds that differ from the plan, with and without the executive: falls."""
    from benchmarks.climb.closed_loop import bench_closed_loop

    return bench_closed_loop(
        seed, run.quick, run.stream, count=count, scenes=scenes, kinds=kinds, folder=out
    )


@benchmark()
def courses(
    run: Run,
    seed: Seed = 0,
    scenes: Annotated[
        str | None, name_option("--scenes", "NAMES", "Courses, by commas: stairs, rubble, stones.")
    ] = None,
    count: Annotated[int | None, number_option("--count", "Meshes of each [20, 20, 10].")] = None,
    out: Results = None,
) -> Mapping[str, Any]:
    """Seeded stairs, rubble and stepping stones: verified, standing, processor time."""
    from benchmarks.climb.courses import bench_courses

    return bench_courses(seed, run.quick, run.stream, count, scenes, out)
