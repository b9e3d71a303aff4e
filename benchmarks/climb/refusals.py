"""`refusals`: what becomes of random climbs, and whether refusals stand up to more time.

Each climb is planned by method `auto` within a limit. What ends without a proof is tried again by
every method with ten times as long, and more starts: a refusal stands if none finds a plan. A proof
is tried in the same way, and must stand always.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from benchmarks.climb.random_climbs import random_climb
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import LoadedClimb, load_climb
from climbplan.errors import Infeasible, NoPlanFound, UsageError

_LIMIT = 20.0  # [s] of a climb
_LONGER = 10.0  # factor on it for the second try of all methods
_STARTS = 40  # of `nlp` then
_METHODS = ("micp", "nlp", "coupled", "coupled-nlp")
_KEPT = 1.1  # of the limit


@dataclass(frozen=True)
class Outcome:
    """What became of one climb."""

    word: str  # "planned", "proved", "not proved"
    seconds: float
    cpu: float
    remedies: int
    method: str


def bench_refusals(
    seed: int, quick: bool, out: TextIO, count: int | None = None, seconds: float = _LIMIT
) -> None:
    """Random climbs seed, seed + 1, ...: 60 of them, 6 with `quick`, which does not try again.

    seconds: limit of a climb.
    """
    count = count or (6 if quick else 60)
    found: list[Outcome] = []
    stood = fell = 0
    print(f"{'climb':>6}{'outcome':>12}{'wall s':>8}{'CPU s':>8}  method, remedies", file=out)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(seed, seed + count):
            path = random_climb(number, Path(folder))
            one = _planned(load_climb(path, [f"solver.time_limit={seconds}"]))
            found.append(one)
            told = one.method or f"{one.remedies} remedies that work"
            line = f"{number:>6}{one.word:>12}{one.seconds:>8.1f}{one.cpu:>8.1f}  {told}"
            if one.word != "planned" and not quick:
                by = _second_try(path, _LONGER * seconds)
                stood, fell = stood + (by == ""), fell + (by != "")
                line += f"; ten times as long: {by or 'no plan'}"
            print(line, file=out, flush=True)
    late = sum(one.seconds > _KEPT * seconds for one in found)
    words = {word: sum(one.word == word for one in found) for word in ("planned", "proved")}
    refused = count - words["planned"]
    print(
        f"{count} climbs: {words['planned']} planned, {words['proved']} proved impossible, "
        f"{refused - words['proved']} not proved; {sum(o.remedies > 0 for o in found)} of "
        f"{refused} refusals name a change with which a plan was found; {late} beyond "
        f"{_KEPT:g} times the limit of {seconds:g} s",
        file=out,
    )
    if not quick and refused:
        print(
            f"refusals for which no method found a plan in {_LONGER:g} times the limit: {stood} of "
            f"{refused} ({stood / refused:.0%})",
            file=out,
        )


def _planned(loaded: LoadedClimb) -> Outcome:
    begin, clock = time.perf_counter(), time.process_time()
    word, remedies, method = "planned", 0, ""
    try:
        method = plan_climb(loaded).solvers["method"]
    except Infeasible:
        word = "proved"
    except NoPlanFound as error:
        word, remedies = "not proved", len(error.remedies)
    spent = time.process_time() - clock
    return Outcome(word, time.perf_counter() - begin, spent, remedies, method)


def _second_try(path: Path, limit: float) -> str:
    """The method that finds a plan after all within a limit [s], "" if none does."""
    for method in _METHODS:
        loaded = load_climb(
            path,
            [
                f"solver.method={method}",
                f"solver.time_limit={limit}",
                f"solver.starts={_STARTS}",
            ],
        )
        try:
            plan = plan_climb(loaded)
        except (NoPlanFound, UsageError):  # or a method that cannot state the climb
            continue
        if verify_plan(plan).passed:
            return method
    return ""
