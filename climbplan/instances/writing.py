"""The set as a folder: files for any solver, a table, and the script that checks solutions."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from io import StringIO
from pathlib import Path

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.errors import UsageError
from climbplan.instances.families import FAMILIES, LEVELS, Named, the_set
from climbplan.program.instance import Instance
from climbplan.progress import Progress
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.model_file import save_model

KNOWN_SEED = 0  # of the instances whose values come with the package
_ROOM = "climbplan.instances"
_CHECKER = "check_solution.py"
_COLUMNS = (
    *("name", "file", "family", "class", "size", "unit"),
    *("variables", "integers", "rows", "nonzeros", "products", "cones"),
    *("best_known", "bound", "status", "by"),
)
_README = """\
Mixed-integer problems of robots in contact, drawn by climbplan with seed {seed}.

    {families}

`instances.csv` has one line an instance: file, size, class, the best value known and a valid lower
bound where there is one (`by`: who found the value). Implications and choices are big-M rows whose
constants come from bounds. Linear rows with a linear or convex quadratic cost are .mps files, with
variables x0, x1, ...; products and second-order cones make it an .nl file, with names in .col and
.row files beside it: x of the problem, w of products, the others stand for rows and squares.

    python check_solution.py NAME.mps SOLUTION.sol

reads an instance without climbplan and judges a solution (lines `name value`); NumPy, PySCIPOpt
and CasADi are all it needs. Minimise throughout; all integers are binaries.
"""


@dataclass(frozen=True)
class KnownValue:
    """What is known of an instance."""

    value: float | None  # of a point that was checked, None if there is none
    bound: float
    infeasible: bool
    by: str

    @property
    def status(self) -> str:
        """`optimal` where the bound is within 1e-4 of the value, `open`, or `infeasible`."""
        if self.infeasible:
            return "infeasible"
        if self.value is None:
            return "open"
        closed = self.value - self.bound <= 1e-4 * max(abs(self.value), 1e-6)
        return "optimal" if closed else "open"


def known_values() -> dict[str, KnownValue]:
    """By name, of the instances of seed 0; made by `python -m benchmarks instances`."""
    text = files(_ROOM).joinpath("known.csv").read_text()
    return {
        row["name"]: KnownValue(
            float(row["value"]) if row["value"] else None,
            float(row["bound"]),
            row["infeasible"] == "yes",
            row["by"],
        )
        for row in csv.DictReader(StringIO(text))
    }


def file_name(named: Named, instance: Instance) -> str:
    """The name of its file: .nl where there are products or cones, .mps elsewhere."""
    return named.name + (".nl" if {"products", "balls"} & instance.features else ".mps")


def file_point(instance: Instance, x: Array, assignment: IntArray | None) -> dict[str, float]:
    """A point as the file has it: x and the binaries of choices by name."""
    picks = instance.assignment(x) if assignment is None else assignment
    parts = [np.asarray(x, float)]
    for choice, chosen in zip(instance.choices, picks, strict=True):
        parts.append(np.eye(len(choice.alternatives))[int(chosen)])
    return {f"x{k}": float(v) for k, v in enumerate(np.concatenate(parts))}


def write_set(folder: Path, seed: int, count: int, report: Progress) -> int:
    """Write `count` instances of each family and class into an empty folder; how many there are.

    Raises UsageError where a file cannot be written, MissingSolver without PySCIPOpt or pymunk.
    """
    known = known_values() if seed == KNOWN_SEED else {}
    chosen = the_set(count)
    if not chosen:
        raise UsageError("--count: expected at least 1")
    with (folder / "instances.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(_COLUMNS)
        for k, named in enumerate(chosen):
            instance = named.drawn(seed)
            name = file_name(named, instance)
            save_model(instance, folder / name)
            table.writerow(_line(named, instance, name, known.get(named.name)))
            report("instances", (k + 1) / len(chosen))
    (folder / _CHECKER).write_text(files(_ROOM).joinpath(_CHECKER).read_text())
    listed = "\n    ".join(f"{f.name:<12} {f.what}" for f in FAMILIES)
    (folder / "README.md").write_text(_README.format(seed=seed, families=listed))
    return len(chosen)


def _line(
    named: Named, instance: Instance, name: str, known: KnownValue | None
) -> Iterator[str | int]:
    form = BigM().apply(instance).instance
    family = named.family
    yield from (named.name, name, family.name, named.level)
    yield from (family.sizes[LEVELS.index(named.level)], family.unit)
    yield from (form.size, int(form.integer.sum()), form.A.shape[0])
    yield from (int(form.A.nnz), form.products.count, sum(b.count for b in form.balls))
    if known is None:
        yield from ("", "", "unknown", "")
        return
    yield "" if known.value is None else f"{known.value:.12g}"
    yield "" if not np.isfinite(known.bound) else f"{known.bound:.12g}"
    yield from (known.status, known.by)
