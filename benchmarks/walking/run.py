"""`mpc`: offline methods, envelopes, bounds, online, a table each."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any, TextIO

from benchmarks.walking.bounds import bound_table
from benchmarks.walking.envelope_accuracy import accuracy_table
from benchmarks.walking.horizons import horizon_table
from benchmarks.walking.learned import strategy_table
from benchmarks.walking.offline import offline_tables
from benchmarks.walking.online import tick_tables
from benchmarks.walking.online_options import OnlineOptions, online_inputs
from benchmarks.walking.pushes import push_table
from benchmarks.walking.recovery import recovery_table
from benchmarks.walking.stones import stones_table
from benchmarks.walking.workers import end_workers
from climbplan.errors import UsageError

Section = Callable[[int, bool, int, TextIO], None]  # seed, quick, processes, where to print
OFFLINE: dict[str, Section] = {
    "offline": offline_tables,
    "envelopes": lambda seed, quick, jobs, stream: accuracy_table(seed, quick, stream),
    "bounds": bound_table,
    "stones": stones_table,
    "horizons": horizon_table,
}
ONLINE = ("ticks", "strategies", "recovery", "pushes")


def run_mpc(
    options: OnlineOptions,
    tables: str | None,
    stream: TextIO,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Print tables, all if none are named; gives the figures of the online ones.

    Raises:
        UsageError: a table that does not exist, or files that cannot be used.
    """
    chosen = _chosen(tables)
    # Files and assignments are looked at before anything runs for minutes.
    inputs = online_inputs(options, report) if set(chosen) & set(ONLINE) else None
    found: dict[str, Any] = {"load": os.getloadavg()[0]}
    spent: dict[str, float] = {}
    for name in chosen:
        begin, used = time.perf_counter(), _processor_time()
        if name in OFFLINE:
            OFFLINE[name](options.seed, options.quick, options.jobs, stream)
        elif inputs is not None and name == "ticks":
            found[name] = tick_tables(inputs, options.seed, options.quick, stream)
        elif inputs is not None and name == "strategies":
            found[name] = strategy_table(inputs, options.seed, options.quick, stream)
        elif inputs is not None and name == "pushes":
            found[name] = push_table(inputs, options, stream, report)
        elif inputs is not None:
            found[name] = recovery_table(inputs, options, stream, report)
        if options.jobs > 1:
            end_workers()
        spent[name] = time.perf_counter() - begin
        print(
            f"{name}: {spent[name]:.0f} s, {_processor_time() - used:.0f} s of processor time\n",
            file=stream,
            flush=True,
        )
    if len(chosen) > 1:
        print(f"took {sum(spent.values()) / 60:.1f} minutes", file=stream)
    found["seconds"] = spent
    return found


def _processor_time() -> float:
    """Of this process and of workers that have ended [s]."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def _chosen(tables: str | None) -> list[str]:
    known = [*OFFLINE, *ONLINE]
    names = known if tables is None else [name.strip() for name in tables.split(",")]
    if unknown := [name for name in names if name not in known]:
        raise UsageError(f"--methods: expected some of {', '.join(known)}, got {unknown[0]!r}")
    return names
