"""Benchmark of motions for learning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from benchmarks.running import Run, benchmark, name_option, number_option


@benchmark()
def motions(
    run: Run,
    dataset: Annotated[
        str | None,
        name_option("--dataset", "DIR", "A dataset of motions, or the hidden folder of a run."),
    ] = None,
    public: Annotated[
        str | None,
        name_option("--public", "FILE", "Public motions, a list in YAML."),
    ] = None,
    scenes: Annotated[
        str | None,
        name_option("--scenes", "NAMES", "Shipped climbs timed by dynamics, by commas, or all."),
    ] = None,
    count: Annotated[
        int | None, number_option("--count", "Motions of each kind [all; quick 3].")
    ] = None,
) -> Mapping[str, Any]:
    """Motions of a dataset and public ones by all measures; climbs timed by their dynamics."""
    from benchmarks.motions.run import bench_motions

    return bench_motions(run.quick, run.stream, dataset, public, scenes, count)
