"""`zoo`: robots of a Python package from URDF to verified plans, with no hand work between.

Each URDF goes through what `climbplan new robot --urdf` does: legs, toes, postures and motors are
proposed; then every column is planned, verified and simulated in its nominal world.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from joblib import Parallel, delayed

from benchmarks.kept_rows import read_rows, write_rows
from benchmarks.zoo.cells import COLUMNS, NOT_SIMULATED, Cell
from benchmarks.zoo.refusals import Drawing, check_refusals
from benchmarks.zoo.results import FILE, Row
from benchmarks.zoo.robot_files import keep_robot
from benchmarks.zoo.robots import QUICK, ROBOTS, Zoo
from benchmarks.zoo.second.look import COUNT
from climbplan.climb.proposed.proposed import ProposalTrials
from climbplan.errors import SpecError, UsageError
from climbplan.robots.urdf.proposal.propose_robot import propose_robot

TABLES = ("plans", "refusals")
_FILES = "robots"  # folder of robot files
_WIDTH = 17


def bench_zoo(
    quick: bool,
    out: TextIO,
    names: str | None = None,
    folder: Path | None = None,
    tables: str | None = None,
    seed: int = 0,
    count: int | None = None,
    jobs: int = 1,
    columns: str | None = None,
) -> dict[str, Any]:
    """Print one line a robot, one robot with `quick`; return the rows.

    names: of robots, by commas. columns: tasks that are planned, by commas; all if left out.
    folder: rows and robot files are kept there, and rows that are there already are not made again.
    tables: `plans`, and `refusals` for what a second method says of those, by `count` postures
    drawn with `seed`. jobs: robots at a time. Raises UsageError for other names, and without the
    package.
    """
    asked = [one.strip() for one in (tables or TABLES[0]).split(",")]
    if unknown := [one for one in asked if one not in TABLES]:
        raise UsageError(f"`zoo` --methods: no table {unknown[0]!r}, known are {', '.join(TABLES)}")
    chosen, tasks = _chosen(quick, names), _choose_columns(columns)
    rows = [] if folder is None else read_rows(folder / FILE, Row)
    head = f"{'robot':<15}  {'kg':>5}  {'legs':>4}  {'first s':>7}"
    print(head + "".join(f"  {column:>{_WIDTH}}" for column in COLUMNS), file=out)
    there = {(row.robot, row.column) for row in rows}
    dues = [(zoo, [c for c in tasks if (zoo.name, c) not in there]) for zoo in chosen]
    ended = {zoo.name for zoo, due in dues if not due}
    waiting = _told([zoo.name for zoo in chosen], ended, rows, out)
    with ExitStack() as stack:
        files = Path(folder or stack.enter_context(tempfile.TemporaryDirectory())) / _FILES
        making = Parallel(n_jobs=jobs, return_as="generator_unordered")
        # The last ones of the table take longest: begun last they would run alone
        for new in making(delayed(_rows)(zoo, due, files) for zoo, due in reversed(dues) if due):
            rows = sorted([*rows, *new], key=_place)
            ended.add(new[0].robot)
            if folder is not None:
                write_rows(folder / FILE, rows)
            waiting = _told(waiting, ended, rows, out)
        mine = [row for zoo in chosen for row in rows if row.robot == zoo.name]
        _sums(mine, out)
        if "refusals" in asked:
            check_refusals(mine, chosen, out, folder, Drawing(files, seed, count or COUNT), jobs)
        return {"rows": [asdict(row) for row in mine]}


def _told(waiting: list[str], ended: set[str], rows: Sequence[Row], out: TextIO) -> list[str]:
    """Print lines of robots in their order, up to one that is not ended; those left."""
    for number, name in enumerate(waiting):
        if name not in ended:
            return waiting[number:]
        print(_line([row for row in rows if row.robot == name]), file=out, flush=True)
    return []


def _place(row: Row) -> int:
    """A row's place in the file: robots as the table has them, others last."""
    names = [zoo.name for zoo in ROBOTS]
    return names.index(row.robot) if row.robot in names else len(names)


def _chosen(quick: bool, names: str | None) -> list[Zoo]:
    known = {zoo.name.lower(): zoo for zoo in ROBOTS}
    asked = [n.strip().lower() for n in (",".join(QUICK) if quick else names or "").split(",")]
    asked = [name for name in asked if name] or list(known)
    if unknown := [name for name in asked if name not in known]:
        listed = ", ".join(zoo.name for zoo in ROBOTS)
        raise UsageError(f"`zoo` --scenes: no robot {unknown[0]!r}, known are {listed}")
    return [known[name] for name in asked]


def _choose_columns(columns: str | None) -> list[str]:
    """Return the tasks of the table that are planned; raises UsageError for other names."""
    names = [name.strip() for name in (columns or ",".join(COLUMNS)).split(",")]
    if unknown := [name for name in names if name not in COLUMNS]:
        listed = ", ".join(COLUMNS)
        raise UsageError(f"`zoo` --columns: no task {unknown[0]!r}, known are {listed}")
    return [column for column in COLUMNS if column in names]


def _rows(zoo: Zoo, columns: Sequence[str], files: Path) -> list[Row]:
    """Everything asked of one robot; its robot file is written in `files`."""
    begin = time.process_time()
    with ExitStack() as stack:
        urdf = zoo.urdf(stack)
        try:
            found = propose_robot(urdf)
        except (SpecError, UsageError) as error:
            why = str(error).partition("\n")[0].replace(str(urdf), urdf.name)
            return [Row(zoo.name, 0.0, 0, 0.0, column, False, "", why, 0.0) for column in columns]
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        trials, robot = ProposalTrials(found, place), found.robot
        keep_robot(files, zoo, trials.proposal)
        spent = time.process_time() - begin
        own = [round(robot.mass, 2), robot.limb_count, round(spent, 2)]
        out = []
        for column in columns:
            cell: Cell = COLUMNS[column](trials, lambda words: None)
            words = " ".join(cell.words.split())
            out.append(
                Row(
                    zoo.name, float(own[0]), int(own[1]), float(own[2]), column, cell.planned,
                    cell.simulated, words, round(cell.cpu, 2),
                )
            )  # fmt: skip
        return out


def _line(rows: list[Row]) -> str:
    """A robot's line: CPU seconds to its first verified plan, and how each plan ends in MuJoCo."""
    by_column = {row.column: row for row in rows}
    first, spent = "-", 0.0
    ends = []
    for column in COLUMNS:
        row = by_column.get(column)
        if row is None:
            ends.append("not run")
            continue
        spent += row.cpu
        if row.planned and first == "-":
            first = f"{row.proposed + spent:.1f}"
        ends.append(row.simulated if row.planned else "refused")
    name = rows[0]
    size = f"{name.robot:<15}  {name.mass:>5.1f}  {name.legs:>4}  {first:>7}"
    return size + "".join(f"  {end:>{_WIDTH}}" for end in ends)


def _sums(rows: list[Row], out: TextIO) -> None:
    """Shares by column and in all, then every refusal in its words."""
    planned = [row for row in rows if row.planned]
    stands = sum(row.simulated == "stands" for row in planned)
    played = [row for row in planned if row.simulated != NOT_SIMULATED]
    falls = sum(row.simulated.startswith("falls") for row in played)
    share = f"{100 * len(planned) / max(len(rows), 1):.0f} %"
    print(
        f"{len(planned)} of {len(rows)} cells planned and verified, {share}; in simulation "
        f"{len(played) - falls} of {len(played)} do not fall, {stands} without a slip or a lost "
        "contact",
        file=out,
    )
    told: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if not row.planned:
            told.setdefault((row.robot, row.words), []).append(row.column)
    for (robot, words), columns in told.items():
        print(f"  {robot}, {', '.join(columns)}: {words}", file=out)
