"""Write the benchmark set as a folder: files for any solver, a table, and the checker script."""

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
from climbplan.instances.families import FAMILIES, LEVELS, NamedInstance, list_instances
from climbplan.program.instance import Instance
from climbplan.progress import Progress
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.model_file import save_model

KNOWN_SEED = 0  # seed of the instances whose values are shipped with the package
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
    """The best known value and bound of an instance."""

    value: float | None  # value of a checked point, None without one
    bound: float
    infeasible: bool
    by: str

    @property
    def status(self) -> str:
        """Status `optimal` where the bound is within 1e-4 of the value, `open`, or `infeasible`."""
        if self.infeasible:
            return "infeasible"
        if self.value is None:
            return "open"
        closed = self.value - self.bound <= 1e-4 * max(abs(self.value), 1e-6)
        return "optimal" if closed else "open"


def read_known_values() -> dict[str, KnownValue]:
    """Read values by name for the instances of seed 0, made by `python -m benchmarks instances`."""
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


def format_file_name(named: NamedInstance, instance: Instance) -> str:
    """Return the file name of an instance: .nl with products or cones, else .mps."""
    return named.name + (".nl" if {"products", "balls"} & instance.features else ".mps")


def build_file_point(instance: Instance, x: Array, assignment: IntArray | None) -> dict[str, float]:
    """Return a point as in the file: x and the binaries of choices by name."""
    alternatives = instance.assignment(x) if assignment is None else assignment
    arrays = [np.asarray(x, float)]
    for choice, chosen in zip(instance.choices, alternatives, strict=True):
        arrays.append(np.eye(len(choice.alternatives))[int(chosen)])
    return {f"x{k}": float(v) for k, v in enumerate(np.concatenate(arrays))}


def write_set(folder: Path, seed: int, count: int, report: Progress) -> int:
    """Write `count` instances of each family and class into an empty folder; return their number.

    Raises:
        UsageError: A file cannot be written.
        MissingSolver: PySCIPOpt or pymunk is not installed.
    """
    known_value_of = read_known_values() if seed == KNOWN_SEED else {}
    instances = list_instances(count)
    if not instances:
        raise UsageError("--count: expected at least 1")
    with (folder / "instances.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(_COLUMNS)
        for k, named in enumerate(instances):
            instance = named.generate(seed)
            name = format_file_name(named, instance)
            save_model(instance, folder / name)
            table.writerow(_generate_row(named, instance, name, known_value_of.get(named.name)))
            report("instances", (k + 1) / len(instances))
    (folder / _CHECKER).write_text(files(_ROOM).joinpath(_CHECKER).read_text())
    listed = "\n    ".join(f"{f.name:<12} {f.what}" for f in FAMILIES)
    (folder / "README.md").write_text(_README.format(seed=seed, families=listed))
    return len(instances)


def _generate_row(
    named: NamedInstance, instance: Instance, name: str, known_value: KnownValue | None
) -> Iterator[str | int]:
    """Yield the entries of one row of the table."""
    form = BigM().apply(instance).instance
    family = named.family
    yield from (named.name, name, family.name, named.level)
    yield from (family.sizes[LEVELS.index(named.level)], family.unit)
    yield from (form.size, int(form.integer.sum()), form.A.shape[0])
    yield from (int(form.A.nnz), form.products.count, sum(b.count for b in form.balls))
    if known_value is None:
        yield from ("", "", "unknown", "")
        return
    yield "" if known_value.value is None else f"{known_value.value:.12g}"
    yield "" if not np.isfinite(known_value.bound) else f"{known_value.bound:.12g}"
    yield from (known_value.status, known_value.by)
