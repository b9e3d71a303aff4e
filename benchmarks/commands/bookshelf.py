"""Benchmarks of the bookshelf."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from benchmarks.running import (
    Run,
    Seed,
    benchmark,
    choose_options,
    name_option,
    number_option,
)

Scenes = Annotated[
    str | None,
    name_option("--scenes", "FILE[:GROUP]", "Scenes to solve [default: generated, with pymunk]."),
]
Library = Annotated[
    Path | None,
    name_option("--library", "FILE", "Solved scenes for methods that learn [default: generated]."),
]
LibrarySize = Annotated[
    int | None, number_option("--library-size", "Generated scenes in the library [1000; quick 100]")
]


@benchmark(writes_files=True)
def bookshelf(
    run: Run,
    seed: Seed = 0,
    scenes: Scenes = None,
    library: Library = None,
    published: Annotated[
        str | None,
        name_option(
            "--published", "FILE[:GROUP]", "Published placements (theta, X) to check and compare."
        ),
    ] = None,
    methods: Annotated[str | None, name_option("--methods", "NAMES", "By commas [all].")] = None,
    count: Annotated[
        int | None, number_option("--count", "Scenes [40; quick 8]; 0: only --published.", 0)
    ] = None,
    some: Annotated[
        int | None,
        number_option("--some", "Scenes of methods that take about a second [20; quick 3]."),
    ] = None,
    few: Annotated[
        int | None, number_option("--few", "Scenes of the slowest methods [4; quick 1].")
    ] = None,
    time_limit: Annotated[
        float | None,
        number_option("--time-limit", "Of one scene of the slowest methods [s] [5; quick 2].", 0.1),
    ] = None,
    library_size: LibrarySize = None,
) -> Mapping[str, Any]:
    """All methods on the same bookshelf scenes, and published placements."""
    from benchmarks.bookshelf.plots import write_plots
    from benchmarks.bookshelf.run import BenchOptions, as_json, bench_bookshelf, write_text

    quick = {"count": 8, "some": 3, "few": 1, "seconds": 2.0, "library_size": 100}
    options = BenchOptions(
        **choose_options(
            quick,
            run,
            seed=seed,
            scenes=scenes,
            library=library,
            published=published,
            methods=methods,
            count=count,
            some=some,
            few=few,
            seconds=time_limit,
            library_size=library_size,
        )
    )
    result = bench_bookshelf(options, run.report)
    write_text(result, run.stream)
    if run.directory is not None and result.runs:
        write_plots(result.runs, result.figures, result.best, run.directory)
    return {"options": asdict(options), **as_json(result)}


@benchmark(writes_files=True)
def strategies(
    run: Run,
    seed: Seed = 0,
    scenes: Scenes = None,
    library: Library = None,
    methods: Annotated[
        str | None,
        name_option(
            "--methods",
            "NAMES",
            "Strategies, by commas [all; quick random, knn, forest, network].",
        ),
    ] = None,
    count: Annotated[int | None, number_option("--count", "Scenes [100; quick 12].")] = None,
    some: Annotated[
        int | None, number_option("--some", "Scenes of `reduce`, seconds each [20; quick 2].")
    ] = None,
    few: Annotated[
        int | None, number_option("--few", "Scenes of each other distribution [60; quick 6].")
    ] = None,
    clusters: Annotated[
        int | None,
        number_option(
            "--clusters", "Clusters whose reduced programs HiGHS and SCIP solve [6; quick 1].", 0
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        number_option("--time-limit", "Of one scene and program [s] [60; quick 10].", 0.1),
    ] = None,
    library_size: LibrarySize = None,
) -> Mapping[str, Any]:
    """Trained strategies beside each other and beside exact, by data size."""
    from benchmarks.bookshelf.strategies import StrategyOptions, as_json, bench_strategies
    from benchmarks.bookshelf.strategy_plots import comparison
    from benchmarks.bookshelf.strategy_tables import write_text

    quick = {
        "count": 12,
        "some": 2,
        "few": 6,
        "clusters": 1,
        "seconds": 10.0,
        "library_size": 100,
        "methods": "random,knn,forest,network",
    }
    options = StrategyOptions(
        **choose_options(
            quick,
            run,
            seed=seed,
            scenes=scenes,
            library=library,
            methods=methods,
            count=count,
            some=some,
            few=few,
            clusters=clusters,
            seconds=time_limit,
            library_size=library_size,
        )
    )
    result = bench_strategies(options, run.report)
    write_text(result, run.stream)
    if run.directory is not None:
        comparison(result).savefig(run.directory / "strategies.png")
    return {"options": asdict(options), **as_json(result)}
