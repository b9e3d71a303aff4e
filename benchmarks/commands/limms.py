"""Benchmarks of modules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from benchmarks.running import (
    Run,
    Seed,
    benchmark,
    choose_options,
    name_option,
    number_option,
)


@benchmark(writes_files=True)
def limms(
    run: Run,
    seed: Seed = 0,
    methods: Annotated[
        str | None,
        name_option(
            "--methods",
            "NAMES",
            "By commas: modes, admm, admm-published, masses, rooms, turned [all].",
        ),
    ] = None,
    count: Annotated[
        int | None,
        number_option(
            "--count",
            "Random throws, jumps, rooms and turned rooms [30, 30, 40, 30; quick 1 each]; "
            "0: shipped scenes only.",
            0,
        ),
    ] = None,
    time_limit: Annotated[
        float | None, number_option("--time-limit", "Of one plan [s] [1000; quick 60].", 0.1)
    ] = None,
) -> Mapping[str, Any]:
    """Search and consensus on the same scenes of modules, random ones, and random rooms."""
    from benchmarks.limms.run import LimmsOptions, as_json, bench_limms

    quick = {"count": 1, "seconds": 60.0, "scenes": ("limms_throw",)}
    chosen = choose_options(quick, run, seed=seed, methods=methods, count=count, seconds=time_limit)
    options = LimmsOptions(**chosen)
    return {"options": asdict(options), **as_json(bench_limms(options, run.report, run.stream))}
