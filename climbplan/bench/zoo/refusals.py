"""The second table of `bench zoo`: what a second method says of each refusal, kept as rows are."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TextIO

from climbplan.bench.zoo.results import Row
from climbplan.bench.zoo.robots import Zoo
from climbplan.bench.zoo.second.look import COUNT, second_look
from climbplan.errors import UsageError
from climbplan.plans.csv_file import write_csv

FILE = "refusals.csv"


@dataclass(frozen=True)
class Checked:
    """One refused cell, looked at again."""

    robot: str
    column: str
    refusal: str
    verdict: str
    words: str
    reached: int
    drawn: int


def check_refusals(
    rows: Sequence[Row],
    zoos: Sequence[Zoo],
    out: TextIO,
    folder: Path | None,
    seed: int,
    count: int | None,
) -> None:
    """One line for each refused cell of the robots, and how many refusals stand.

    What `folder` has of the same refusals is not looked at again.
    """
    known = [] if folder is None else _kept(folder)
    zoo_of = {zoo.name: zoo for zoo in zoos}
    found: list[Checked] = []
    for row in rows:
        if row.planned or row.robot not in zoo_of:
            continue
        same = (row.robot, row.column, row.words)
        done = [one for one in known if (one.robot, one.column, one.refusal) == same]
        one = done[0] if done else _checked(row, zoo_of[row.robot], seed, count or COUNT)
        found.append(one)
        drawn = f" ({one.reached} postures of {one.drawn} drawn)" if one.drawn else ""
        head = f"  {one.robot}, {one.column}: {one.verdict}"
        print(f"{head}: {one.words}{drawn}", file=out, flush=True)
        if folder is not None and not done:
            known.append(one)
            names = [field.name for field in fields(Checked)]
            write_csv(folder / FILE, names, [asdict(each).values() for each in known])
    verdicts = [one.verdict for one in found]
    parts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    told = f"{len(found)} refusals looked at again by drawn postures and statics of all links"
    print(f"{told}: {parts}" if found else "nothing is refused", file=out)


def _checked(row: Row, zoo: Zoo, seed: int, count: int) -> Checked:
    with ExitStack() as stack:
        look = second_look(zoo.urdf(stack), row.column, row.words, seed, count)
    return Checked(
        row.robot, row.column, row.words, look.verdict, look.words, look.reached, look.drawn
    )


def _kept(folder: Path) -> list[Checked]:
    path = folder / FILE
    if not path.exists():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return [
                Checked(
                    row["robot"], row["column"], row["refusal"], row["verdict"], row["words"],
                    int(row["reached"]), int(row["drawn"]),
                )
                for row in csv.DictReader(stream)
            ]  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path}: no refusals of `bench zoo`: {error}") from error
