"""Read an instance of the set and check a solution; needs NumPy, PySCIPOpt and CasADi only.

    python check_solution.py INSTANCE.mps|INSTANCE.nl SOLUTION.sol

Files are read by a library that did not write them: .mps files are written by HiGHS and read by
SCIP, .nl files are written by SCIP and read by CasADi. A solution has one `name value` on each
line, # begins a comment. An .nl file has variables for squares, products and rows; those missing in
a solution are computed from the row that defines them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


TOLERANCE = 1e-5  # of rows and bounds relative to 1 and their size, and of integers
_HEADER_LINES = 10  # of an .nl file
_COUNT = re.compile(rb"\d{1,9}")
_ROW_KINDS = ("N", "L", "G", "E")  # of an .mps file
_HUGE = 1e19  # SCIP's and the formats' infinity


@dataclass(frozen=True)
class SolverModel:
    """Minimise objective(v) subject to lower <= v <= upper, row_lower <= rows(v) <= row_upper."""

    names: tuple[str, ...]
    lower: Array
    upper: Array
    integer: BoolArray
    row_lower: Array
    row_upper: Array
    objective: Callable[[Array], float]
    rows: Callable[[Array], Array]
    slopes: Callable[[Array], Array] | None  # dense Jacobian of the rows; None for .mps files


@dataclass(frozen=True)
class PointViolations:
    """Value and worst violations of a point."""

    objective: float
    rows: float  # relative to 1 and the size of the bound
    bounds: float
    integrality: float

    @property
    def feasible(self) -> bool:
        """Check whether all violations are within the tolerance."""
        return max(self.rows, self.bounds, self.integrality) <= TOLERANCE


def read_instance(path: Path) -> SolverModel:
    """Read the model in a file.

    Raises:
        ValueError: The suffix is unknown.
    """
    if path.suffix == ".mps":
        return _read_mps(path)
    if path.suffix == ".nl":
        return _read_nl(path)
    raise ValueError(f"{path}: expected .mps or .nl")


def read_solution(path: Path) -> dict[str, float]:
    """Read values by name.

    Raises:
        ValueError: A line has no name and value.
    """
    values = {}
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        text = line.partition("#")[0].split()
        if not text:
            continue
        try:
            name, value = text
            values[name] = float(value)
        except ValueError as error:
            raise ValueError(f"{path}:{number}: expected `name value`, got {line!r}") from error
    return values


def check(model: SolverModel, values: dict[str, float]) -> PointViolations:
    """Check a solution.

    Raises:
        ValueError: A name is unknown, or a missing value is not defined by a row.
    """
    index = {name: k for k, name in enumerate(model.names)}
    unknown = sorted(set(values) - set(index))
    if unknown:
        raise ValueError(f"no variable {unknown[0]!r} in the instance")
    v, is_known = np.zeros(len(index)), np.zeros(len(index), bool)
    for name, value in values.items():
        v[index[name]], is_known[index[name]] = value, True
    v = _complete_values(model, v, is_known)
    row = model.rows(v)
    low, high = model.row_lower, model.row_upper
    row_violation = np.maximum(_compute_violation(low, row), _compute_violation(row, high))
    bound_violation = np.maximum(
        _compute_violation(model.lower, v), _compute_violation(v, model.upper)
    )
    fraction = np.abs(v - np.round(v))[model.integer]
    worst = [
        float(violation.max(initial=0.0))
        for violation in (row_violation, bound_violation, fraction)
    ]
    return PointViolations(model.objective(v), *worst)


def _compute_violation(small: Array, large: Array) -> Array:
    """Return the violation of small <= large, relative to 1 and the smaller of both sizes."""
    with np.errstate(invalid="ignore"):
        difference = np.maximum(small - large, 0.0)
    return np.asarray(difference / np.maximum(1.0, np.minimum(np.abs(small), np.abs(large))))


def _complete_values(model: SolverModel, v: Array, is_known: BoolArray) -> Array:
    """Compute missing values, each from a row in which no other one is missing."""
    while not is_known.all():
        missing = np.flatnonzero(~is_known)
        if model.slopes is None:
            raise ValueError(f"the solution has no value of {model.names[missing[0]]!r}")
        row_value, slope = model.rows(v), model.slopes(v)[:, missing]
        has_single = np.count_nonzero(slope, axis=1) == 1
        equal = model.row_lower == model.row_upper
        # Equations define values; without any, a minimal value lies on its inequality
        rows = np.flatnonzero(has_single & equal)
        if not len(rows):
            rows = np.flatnonzero(has_single)
        if not len(rows):
            raise ValueError(f"the solution has no value of {model.names[missing[0]]!r}")
        for r in rows:
            k = int(np.flatnonzero(slope[r])[0])
            if is_known[missing[k]]:
                continue
            end = model.row_upper[r] if np.isfinite(model.row_upper[r]) else model.row_lower[r]
            v[missing[k]] = (end - row_value[r]) / slope[r, k]
            is_known[missing[k]] = True
    return v


def _check_mps(path: Path) -> None:
    """Raise ValueError for a file with rows on which SCIP's reader of .mps files crashes."""
    section = ""
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        fields = line.partition("$")[0].split()  # a comment begins with $
        if not fields or line.startswith("*"):
            continue
        if not line[0].isspace():
            section = fields[0]
        elif section == "ROWS" and (len(fields) != 2 or fields[0] not in _ROW_KINDS):
            raise ValueError(
                f"{path}:{number}: expected N, L, G or E and a name of a row, got {line[:80]!r}"
            )
    if section != "ENDATA":
        raise ValueError(f"{path}: expected an .mps file, which ends with ENDATA")


def _read_mps(path: Path) -> SolverModel:
    """Read an .mps file with SCIP."""
    import pyscipopt

    _check_mps(path)
    scip: Any = pyscipopt.Model()
    scip.hideOutput()
    scip.readProblem(str(path))
    variables = [v for v in scip.getVars() if v.name != "qmatrixvar"]
    place = {v.name: k for k, v in enumerate(variables)}
    entries: list[tuple[int, int, float]] = []
    ends: list[tuple[float, float]] = []
    squares: list[tuple[int, int, float]] = []
    for row in scip.getConss():
        if row.getConshdlrName() == "nonlinear":  # the quadratic cost, which SCIP has as a row
            products, squared, _ = scip.getTermsQuadratic(row)
            squares += [(place[a.name], place[b.name], c) for a, b, c in products]
            squares += [(place[a.name], place[a.name], c) for a, c, _ in squared]
            continue
        terms = scip.getValsLinear(row)
        entries += [(len(ends), place[name], value) for name, value in terms.items()]
        ends.append((scip.getLhs(row), scip.getRhs(row)))
    r, c, value = (np.array(array) for array in zip(*entries, strict=True))
    cost = np.array([v.getObj() for v in variables])
    offset, count = scip.getObjoffset(), len(ends)

    def objective(v: Array) -> float:
        return float(cost @ v + offset + sum(w * v[i] * v[j] for i, j, w in squares))

    def rows(v: Array) -> Array:
        return np.asarray(np.bincount(r, value * v[c], minlength=count), float)

    return SolverModel(
        names=tuple(v.name for v in variables),
        lower=_replace_infinite(np.array([v.getLbOriginal() for v in variables])),
        upper=_replace_infinite(np.array([v.getUbOriginal() for v in variables])),
        integer=np.array([v.vtype() in ("BINARY", "INTEGER") for v in variables]),
        row_lower=_replace_infinite(np.array([low for low, _ in ends])),
        row_upper=_replace_infinite(np.array([high for _, high in ends])),
        objective=objective,
        rows=rows,
        slopes=None,
    )


def _check_nl(path: Path) -> None:
    """Raise ValueError for a file without the text header of .nl, on which CasADi hangs."""
    lines = path.read_bytes().splitlines()[:_HEADER_LINES]
    starts = [line.split(b"#")[0].split() for line in lines]
    is_text = len(lines) == _HEADER_LINES and lines[0].startswith(b"g")
    counts = starts[1:] if is_text else [[]]
    if not all(entry and all(_COUNT.fullmatch(number) for number in entry) for entry in counts):
        raise ValueError(
            f"{path}: expected an .nl file in text: a line that begins with g, then nine of counts"
        )


def _read_nl(path: Path) -> SolverModel:
    """Read an .nl file with CasADi."""
    import casadi as ca

    _check_nl(path)
    file: Any = ca.NlpBuilder()
    file.import_nl(str(path))
    v = ca.vertcat(*file.x)
    g = ca.vertcat(*file.g)
    f: Any = ca.Function("f", [v], [file.f])
    rows: Any = ca.Function("g", [v], [g])
    slopes: Any = ca.Function("J", [v], [ca.jacobian(g, v)])
    return SolverModel(
        names=tuple(path.with_suffix(".col").read_text().split()),
        lower=_replace_infinite(np.array(file.x_lb, float)),
        upper=_replace_infinite(np.array(file.x_ub, float)),
        integer=np.array(file.discrete, bool),
        row_lower=_replace_infinite(np.array(file.g_lb, float)),
        row_upper=_replace_infinite(np.array(file.g_ub, float)),
        objective=lambda at: float(f(at)),
        rows=lambda at: np.array(rows(at)).ravel(),
        slopes=lambda at: np.array(slopes(at)),
    )


def _replace_infinite(bounds: Array) -> Array:
    """Replace huge bounds by infinite ones."""
    return np.where(np.abs(bounds) >= _HUGE, np.copysign(np.inf, bounds), bounds)


def main(arguments: list[str]) -> int:
    """Print value and violations; return 0 if the solution is feasible, 1 if not, 2 for misuse."""
    if len(arguments) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        model = read_instance(Path(arguments[0]))
        verdict = check(model, read_solution(Path(arguments[1])))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    except Exception as error:  # the libraries raise various exceptions on a broken file
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        print(f"{arguments[0]}: cannot be read: {reason}", file=sys.stderr)
        return 2
    print(f"objective {verdict.objective:.12g}")
    print(f"rows {verdict.rows:.2g}, bounds {verdict.bounds:.2g}, integers", end=" ")
    print(f"{verdict.integrality:.2g}: {'feasible' if verdict.feasible else 'not feasible'}")
    return 0 if verdict.feasible else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
