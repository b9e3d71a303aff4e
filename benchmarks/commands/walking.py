"""Benchmarks of walking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.running import Jobs, Run, Seed, benchmark, name_option, number_option


@benchmark(writes_files=True)
def mpc(
    run: Run,
    seed: Seed = 0,
    methods: Annotated[
        str | None,
        name_option(
            "--methods",
            "NAMES",
            "Tables, by commas: offline, envelopes, bounds, stones, horizons, ticks, strategies, "
            "recovery, pushes [all].",
        ),
    ] = None,
    count: Annotated[
        int | None, number_option("--count", "Walks under each push [20; quick 3].")
    ] = None,
    library: Annotated[
        Path | None, name_option("--library", "FILE", "Solved walks [default: generated].")
    ] = None,
    library_size: Annotated[
        int | None, number_option("--library-size", "Walks of the library [110; quick 6].")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            "-s",
            metavar="KEY=VALUE",
            help="Set a key of mpc_recovery.yaml, whose loop is walked. Repeatable.",
        ),
    ] = None,
    jobs: Jobs = 1,
) -> Mapping[str, Any]:
    """Walking: offline methods, accuracy of envelopes, ticks online, recovery from pushes."""
    from benchmarks.walking.online_options import OnlineOptions
    from benchmarks.walking.run import run_mpc

    options = OnlineOptions(
        seed, run.quick, count, library, library_size, jobs, tuple(assignments or ())
    )
    return {
        "options": asdict(options),
        **run_mpc(options, methods, run.stream, run.report),
    }
