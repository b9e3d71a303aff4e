"""The second table of `zoo`: what a second method says of each refusal, kept as rows are."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TextIO

from joblib import Parallel, delayed

from benchmarks.zoo.results import Row
from benchmarks.zoo.robot_files import robot_file
from benchmarks.zoo.robots import Zoo
from benchmarks.zoo.second.look import CLIMBS, Look, limit_of_walks, second_look
from benchmarks.zoo.second.subject import Subject, subject_of
from benchmarks.zoo.second.unproposed import unproposed
from climbplan.errors import UsageError
from climbplan.store.csv_file import write_csv

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


@dataclass(frozen=True)
class Drawing:
    """How refusals are looked at again."""

    files: Path  # folder of robot files
    seed: int
    count: int  # postures for each


def check_refusals(
    rows: Sequence[Row],
    zoos: Sequence[Zoo],
    out: TextIO,
    folder: Path | None,
    drawing: Drawing,
    jobs: int = 1,
) -> None:
    """One line for each refused cell of the robots, and how many refusals stand.

    What `folder` has of the same refusals is not looked at again. jobs: robots at a time.
    """
    known = [] if folder is None else _kept(folder)
    done = {(one.robot, one.column, one.refusal): one for one in known}
    robots = [(zoo, [r for r in rows if r.robot == zoo.name and not r.planned]) for zoo in zoos]
    robots = [(zoo, refused) for zoo, refused in robots if refused]
    looking = Parallel(n_jobs=jobs, return_as="generator")
    found: list[Checked] = []
    for new in looking(
        delayed(_checked)(zoo, refused, [done.get(_key(row)) for row in refused], drawing)
        for zoo, refused in robots
    ):
        found += new
        for one in new:
            drawn = f" ({one.reached} postures of {one.drawn} drawn)" if one.drawn else ""
            head = f"  {one.robot}, {one.column}: {one.verdict}"
            print(f"{head}: {one.words}{drawn}", file=out, flush=True)
        if folder is not None:
            others = [one for one in known if one.robot not in {each.robot for each in found}]
            names = [field.name for field in fields(Checked)]
            lines = [asdict(each).values() for each in [*others, *found]]
            write_csv(folder / FILE, names, lines)
    verdicts = [one.verdict for one in found]
    parts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    told = f"{len(found)} refusals looked at again by drawn postures and statics of all links"
    print(f"{told}: {parts}" if found else "nothing is refused", file=out)


def _key(row: Row) -> tuple[str, str, str]:
    return row.robot, row.column, row.words


def _checked(
    zoo: Zoo, rows: Sequence[Row], done: Sequence[Checked | None], drawing: Drawing
) -> list[Checked]:
    """What the second method says of a robot's refused cells; done: what is known of them.

    The robot is read once, and columns that ask the same of its limbs, as walks do, are looked at
    once.
    """
    subject: Subject | None = None
    same: dict[str, Look] = {}
    out = []
    for row, known in zip(rows, done, strict=True):
        if known is not None:
            out.append(known)
            continue
        asked = row.column if row.column in CLIMBS else ""
        if (ours := limit_of_walks(row.words)) is not None:
            asked = row.words
            same[asked] = ours
        elif asked not in same and not row.legs:
            with ExitStack() as stack:
                same[asked] = unproposed(
                    zoo.urdf(stack), row.column, row.words, drawing.seed, drawing.count
                )
        elif asked not in same:
            subject = subject or subject_of(robot_file(drawing.files, zoo))
            same[asked] = second_look(subject, row.column, drawing.seed, drawing.count)
        one = same[asked]
        out.append(
            Checked(
                row.robot, row.column, row.words, one.verdict, one.words, one.reached, one.drawn
            )
        )
    return out


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
        raise UsageError(f"{path}: no refusals of `zoo`: {error}") from error
