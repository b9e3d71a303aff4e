"""Benchmarks of robots from URDF files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from benchmarks.running import (
    Jobs,
    Results,
    Run,
    Seed,
    benchmark,
    name_option,
    number_option,
)


@benchmark()
def zoo(
    run: Run,
    seed: Seed = 0,
    scenes: Annotated[
        str | None, name_option("--scenes", "NAMES", "Robots, by commas [all; quick one].")
    ] = None,
    out: Results = None,
    methods: Annotated[
        str | None,
        name_option(
            "--methods",
            "NAMES",
            "Tables, by commas: plans, refusals (looked at again by a second method) [plans].",
        ),
    ] = None,
    count: Annotated[
        int | None, number_option("--count", "Postures that the second method draws.")
    ] = None,
    columns: Annotated[
        str | None,
        name_option(
            "--columns",
            "NAMES",
            "Tasks, by commas: ground, stairs, chimney, wall, forward, turn [all].",
        ),
    ] = None,
    jobs: Jobs = 1,
) -> Mapping[str, Any]:
    """Robots of example-robot-data from URDF to verified plans, and in MuJoCo."""
    from benchmarks.zoo.run import bench_zoo

    return bench_zoo(run.quick, run.stream, scenes, out, methods, seed, count, jobs, columns)
