"""`instances`: solvers on the public set, by shifted geometric means.

As in comparisons on MIPLIB: one time limit, what is not solved counts as the limit, means are
exp(mean(log(t + shift))) - shift. Each row of results is written when it is there, so that a run
that was ended goes on where it was.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TextIO

import numpy as np

from benchmarks.instances.contenders import CONTENDERS, GAP, Contender, timed
from climbplan.errors import UsageError
from climbplan.instances.families import FAMILIES, LEVELS, NamedInstance, list_instances
from climbplan.instances.writing import build_file_point
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.result import SolverResult, relative_gap

COUNT, QUICK_COUNT = 9, 1  # of each family and class
LIMIT, QUICK_LIMIT = 10.0, 2.0  # [s]
SHIFT = 0.1  # [s]
_OFF = 1e-3  # relative: a bound so far above a value that was checked is wrong
_RESULTS, _KNOWN = "results.csv", "known.csv"


@dataclass(frozen=True)
class Row:
    """What one contender did with one instance."""

    name: str
    family: str
    level: str
    contender: str
    seed: int
    limit: float  # [s]
    status: str
    objective: float  # NaN without a point
    bound: float
    cpu: float  # [s]
    nodes: int

    @property
    def solved(self) -> bool:
        """Proved to the gap; for contenders without bounds see `solved_by`."""
        return self.status in ("optimal", "infeasible")


def bench_instances(
    seed: int,
    quick: bool,
    stream: TextIO,
    out: Path | None = None,
    count: int | None = None,
    limit: float | None = None,
    names: str | None = None,
) -> None:
    """Run contenders on `count` instances of each family and class, and print the table.

    out: folder of results.csv, to which rows are added; known.csv with the best values and bounds
    of all rows; solutions/. names: contenders by commas. Raises UsageError for others.
    """
    most = (QUICK_LIMIT if quick else LIMIT) if limit is None else limit
    each = (QUICK_COUNT if quick else COUNT) if count is None else count
    if each < 1:
        raise UsageError("`instances` --count: expected at least 1")
    chosen, absent = _chosen(names)
    for name in absent:
        print(f"left out, not installed: {name}", file=stream)
    rows = [] if out is None else _kept(out)
    done = {(r.name, r.contender) for r in rows if (r.seed, r.limit) == (seed, most)}
    warm = False
    for named in list_instances(each):
        due = [c for c in chosen if (named.name, c.name) not in done]
        if not due:
            continue
        instance = named.generate(seed)
        for contender in due:
            if not instance.features <= contender.holds:
                continue
            if contender.name == "tree" and not warm:
                _compile()
                warm = True
            found, cpu = timed(contender, instance, most)
            rows.append(_row(named, contender, seed, most, found, cpu))
            if out is not None:
                _keep(out, rows)
                _solution(out, named, instance, found, rows)
    asked = {named.name for named in list_instances(each)}
    mine = [r for r in rows if (r.seed, r.limit) == (seed, most) and r.name in asked]
    mine = [r for r in mine if r.contender in {c.name for c in chosen}]
    print_table(mine, most, chosen, stream)
    if out is not None:
        _write(out / _KNOWN, ("name", "value", "bound", "infeasible", "by"), known_rows(rows, seed))


def _chosen(names: str | None) -> tuple[list[Contender], list[str]]:
    """Contenders to run, and those that are not installed."""
    known = {c.name: c for c in CONTENDERS}
    asked = list(known) if names is None else [n.strip() for n in names.split(",")]
    if unknown := [n for n in asked if n not in known]:
        raise UsageError(f"`instances` --methods: no {unknown[0]!r}, known are " + ", ".join(known))
    chosen = [known[n] for n in asked if known[n].available]
    if not chosen:
        raise UsageError("`instances`: none of the solvers is installed")
    return chosen, [n for n in asked if not known[n].available]


def _compile() -> None:
    """Machine code of the tree is made, or read, before times are taken."""
    for family in FAMILIES:
        if family.name == "cart-poles":
            solve_mixed_integer(NamedInstance(family, "easy", 0).generate(0), GAP)


def _row(
    named: NamedInstance,
    contender: Contender,
    seed: int,
    limit: float,
    found: SolverResult,
    cpu: float,
) -> Row:
    value = np.nan if found.objective is None else found.objective
    return Row(
        named.name, named.family.name, named.level, contender.name, seed, limit, found.status,
        value, found.bound, round(cpu, 6), found.nodes,
    )  # fmt: skip


def best_values(rows: Iterable[Row]) -> dict[str, float]:
    """Least objective of each instance that has one."""
    best: dict[str, float] = {}
    for row in rows:
        if np.isfinite(row.objective):
            best[row.name] = min(row.objective, best.get(row.name, np.inf))
    return best


def known_rows(rows: Sequence[Row], seed: int) -> list[tuple[str, ...]]:
    """Best value and bound of each instance: lines of known.csv.

    A bound that a checked point refutes is left out, as is infeasibility.
    """
    own = [row for row in rows if row.seed == seed]
    best = best_values(own)
    lines: list[tuple[str, ...]] = []
    for name in dict.fromkeys(row.name for row in own):
        tried = [row for row in own if row.name == name]
        value = best.get(name, np.inf)
        ends = [row.bound for row in tried if not _refuted(row, value)]
        none = name not in best and any(row.status == "infeasible" for row in tried)
        finders = [row for row in tried if row.objective <= value + 1e-6 * abs(value)]
        finder = min(finders, key=lambda row: row.cpu).contender if finders else ""
        bound = np.inf if none else max([end for end in ends if end < np.inf], default=-np.inf)
        shown = repr(float(value)) if np.isfinite(value) else ""
        lines.append((name, shown, repr(float(min(bound, value))), "yes" if none else "", finder))
    return lines


def _refuted(row: Row, value: float) -> bool:
    """Whether a contender's bound lies above a value that was checked."""
    return row.bound - value > _OFF * max(abs(value), 1e-6)


def solved_by(row: Row, value: float, proves: bool) -> bool:
    """Proved within the gap, or for a contender without bounds the best value reached."""
    if proves:
        return row.solved and not _refuted(row, value)
    return bool(np.isfinite(row.objective)) and relative_gap(row.objective, value) <= GAP


def shifted_mean(seconds: Iterable[float]) -> float:
    """Shifted geometric mean [s]."""
    taken = np.array(list(seconds))
    return float(np.exp(np.mean(np.log(taken + SHIFT))) - SHIFT)


def print_table(
    rows: Sequence[Row], limit: float, chosen: Sequence[Contender], stream: TextIO
) -> None:
    """By class and in all, then by family; ratios to `scip` on what both hold."""
    best = best_values(rows)
    print(
        f"limit {limit:g} s, gap {GAP:g}; shifted geometric means of CPU seconds, shift {SHIFT:g} s"
        f"; what is not solved counts as the limit\n"
        f"{'':<13}{'solver':<11}{'held':>5}{'solved':>8}{'points':>8}{'wrong':>7}{'mean [s]':>10}"
        f"{'of scip':>9}",
        file=stream,
    )
    groups = [("all", rows)]
    groups += [(level, [r for r in rows if r.level == level]) for level in LEVELS]
    groups += [(f.name, [r for r in rows if r.family == f.name]) for f in FAMILIES]
    for title, group in groups:
        against = {r.name: _counted(r, best, limit, True) for r in group if r.contender == "scip"}
        for contender in chosen:
            own = [r for r in group if r.contender == contender.name]
            if not own:
                continue
            taken = {r.name: _counted(r, best, limit, contender.proves) for r in own}
            value = {r.name: best.get(r.name, np.inf) for r in own}
            solved = sum(solved_by(r, value[r.name], contender.proves) for r in own)
            points = sum(bool(np.isfinite(r.objective)) for r in own)
            wrong = sum(_refuted(r, value[r.name]) for r in own)
            shared = [name for name in taken if name in against]
            ratio = "-"
            if shared:
                base = shifted_mean(against[name] for name in shared)
                ratio = f"{shifted_mean(taken[name] for name in shared) / base:.3f}"
            print(
                f"{title:<13}{contender.name:<11}{len(own):>5}{solved:>8}{points:>8}{wrong:>7}"
                f"{shifted_mean(taken.values()):>10.3f}{ratio:>9}",
                file=stream,
            )
            title = ""


def _counted(row: Row, best: dict[str, float], limit: float, proves: bool) -> float:
    """CPU seconds, the limit where it is not solved [s]."""
    solved = solved_by(row, best.get(row.name, np.inf), proves)
    return min(row.cpu, limit) if solved else limit


def _kept(out: Path) -> list[Row]:
    path = out / _RESULTS
    if not path.exists():
        return []
    kinds = {
        "seed": int,
        "nodes": int,
        "limit": float,
        "objective": float,
        "bound": float,
        "cpu": float,
    }
    try:
        with path.open(newline="") as stream:
            found = [
                Row(**{k: kinds.get(k, str)(v) for k, v in row.items()})
                for row in csv.DictReader(stream)
            ]
    except (TypeError, ValueError) as error:
        raise UsageError(f"{path}: no results of `instances`: {error}") from error
    return found


def _keep(out: Path, rows: Sequence[Row]) -> None:
    names = tuple(f.name for f in fields(Row))
    _write(out / _RESULTS, names, [tuple(str(getattr(r, n)) for n in names) for r in rows])


def _solution(
    out: Path, named: NamedInstance, instance: Instance, found: SolverResult, rows: Sequence[Row]
) -> None:
    """The point, if it is the best so far, for the set's own checker."""
    own = [r for r in rows if (r.name, r.seed) == (named.name, rows[-1].seed)]
    if found.x is None or found.objective is None:
        return
    if found.objective > best_values(own)[named.name]:
        return
    folder = out / "solutions"
    folder.mkdir(exist_ok=True)
    point = build_file_point(instance, found.x, found.assignment)
    text = "".join(f"{name} {value!r}\n" for name, value in point.items())
    _replaced(folder / f"{named.name}.sol", f"# objective {found.objective!r}\n{text}")


def _write(path: Path, head: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    text = "\n".join(",".join(line) for line in [tuple(head), *map(tuple, lines)])
    _replaced(path, text + "\n")


def _replaced(path: Path, text: str) -> None:
    """Written aside and renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    aside.write_text(text)
    os.replace(aside, path)
