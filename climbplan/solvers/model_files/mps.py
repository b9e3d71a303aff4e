"""Read MPS files in free format: rows, integers, quadratic costs and quadratic rows.

The sections are those that Gurobi, CPLEX, HiGHS and SCIP write: QUADOBJ and QSECTION hold one
triangle of P in 1/2 x'Px, QMATRIX all of it, and QCMATRIX all of Q in a row's x'Qx. A word that
is not what its place wants is an error; HiGHS 1.16 and SCIP 10 read it as 0 or leave it out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.reading import read_text
from climbplan.solvers.model_files.quadratic_model import (
    MAX_BYTES,
    MAX_ROWS,
    MAX_VARIABLES,
    QuadraticModel,
)

_INFINITE = 1e20  # numbers from here on are no bounds
_TRIANGLES, _MATRICES = ("QUADOBJ", "QSECTION"), ("QMATRIX",)
_SECTIONS = ("ROWS", "COLUMNS", "RHS", "RANGES", "BOUNDS", *_TRIANGLES, *_MATRICES, "QCMATRIX")
_WITHOUT_VALUE = ("FR", "MI", "PL", "BV")
_WITH_VALUE = ("UP", "LO", "FX", "LI", "UI")
_SENSES = {"MAX": True, "MAXIMIZE": True, "MIN": False, "MINIMIZE": False}
_MAX_TOKENS = 5

Entries = dict[tuple[int, int], float]


def read_mps(path: Path) -> QuadraticModel:
    """Read an MPS file.

    Args:
        path: The file.

    Raises:
        UsageError: It cannot be read, is too large, or a line is not what its section wants.
    """
    reader = _MpsReader(path)
    for line in read_text(path, MAX_BYTES, "an MPS file").splitlines():
        reader.read_line(line)
        if reader.section == "ENDATA":
            return reader.build_model()
    reader.fail("ENDATA", "the end of the file")


@dataclass
class _MpsReader:
    """What the lines so far state."""

    path: Path
    number: int = 0  # of the last line
    section: str = ""
    name: str = ""
    maximise: bool = False
    kinds: dict[str, str] = field(default_factory=dict)  # row -> N, L, G or E
    rows: dict[str, int] = field(default_factory=dict)  # constraint -> index
    cost_row: str | None = None
    columns: dict[str, int] = field(default_factory=dict)
    integers: list[bool] = field(default_factory=list)
    is_integer: bool = False  # between INTORG and INTEND
    costs: dict[int, float] = field(default_factory=dict)
    entries: Entries = field(default_factory=dict)
    sides: dict[str, float] = field(default_factory=dict)  # right-hand sides
    ranges: dict[str, float] = field(default_factory=dict)
    lower: dict[int, float] = field(default_factory=dict)
    upper: dict[int, float] = field(default_factory=dict)
    P: Entries = field(default_factory=dict)
    curvature: dict[int, Entries] = field(default_factory=dict)
    quadratic_row: int = -1

    def fail(self, expected: str, text: str) -> NoReturn:
        """Raise the error of the last line."""
        raise UsageError(f"{self.path}:{self.number}: expected {expected}, got {text[:60]!r}")

    def read_line(self, line: str) -> None:
        """Read the next line."""
        self.number += 1
        tokens = line.split()
        if not tokens or line.startswith("*"):
            return
        if not line[0].isspace():
            self._begin_section(tokens)
            return
        if len(tokens) > _MAX_TOKENS + (self.section == "ROWS"):
            self.fail(f"up to {_MAX_TOKENS} words", line)
        if self.section == "OBJSENSE":
            self._read_sense(tokens[0])
        elif self.section == "ROWS":
            self._read_row(tokens)
        elif self.section == "COLUMNS":
            self._read_column(tokens)
        elif self.section in ("RHS", "RANGES"):
            target = self.sides if self.section == "RHS" else self.ranges
            for row, value in self._read_pairs(tokens if len(tokens) % 2 == 0 else tokens[1:]):
                self._check_row(row)
                target[row] = value
        elif self.section == "BOUNDS":
            self._read_bound(tokens)
        elif self.section in (*_TRIANGLES, *_MATRICES, "QCMATRIX"):
            self._read_square(tokens)
        else:
            self.fail("a section such as ROWS at the beginning of a line", line)

    def _begin_section(self, tokens: list[str]) -> None:
        """Begin a section."""
        section = tokens[0].upper()
        if section == "NAME":
            self.name = tokens[1] if len(tokens) > 1 else ""
        elif section == "OBJSENSE":
            if len(tokens) > 1:
                self._read_sense(tokens[1])
        elif section == "QCMATRIX":
            if len(tokens) < 2 or tokens[1] not in self.rows:
                self.fail("QCMATRIX and the name of a row", " ".join(tokens))
            self.quadratic_row = self.rows[tokens[1]]
        elif section not in (*_SECTIONS, "ENDATA"):
            self.fail("one of the sections " + ", ".join(_SECTIONS), tokens[0])
        self.section = section

    def _read_sense(self, token: str) -> None:
        """Read the sense of the cost."""
        if token.upper() not in _SENSES:
            self.fail("MAX or MIN", token)
        self.maximise = _SENSES[token.upper()]

    def _read_row(self, tokens: list[str]) -> None:
        """Read the kind and name of a row; the first row N is the cost."""
        if len(tokens) != 2 or tokens[0].upper() not in "NLGE":
            self.fail("N, L, G or E and the name of a row", " ".join(tokens))
        kind, row = tokens[0].upper(), tokens[1]
        if row in self.kinds:
            self.fail("rows with names that differ", row)
        self.kinds[row] = kind
        if kind == "N":
            self.cost_row = row if self.cost_row is None else self.cost_row
            return
        self.rows[row] = len(self.rows)
        if len(self.rows) > MAX_ROWS:
            self.fail(f"up to {MAX_ROWS} rows", row)

    def _read_column(self, tokens: list[str]) -> None:
        """Read entries of a column, or a marker of integers."""
        if len(tokens) == 3 and tokens[1].strip("'") == "MARKER":
            marker = tokens[2].strip("'")
            if marker not in ("INTORG", "INTEND"):
                self.fail("INTORG or INTEND", tokens[2])
            self.is_integer = marker == "INTORG"
            return
        name = tokens[0]
        if name not in self.columns:
            if len(self.columns) >= MAX_VARIABLES:
                self.fail(f"up to {MAX_VARIABLES} columns", name)
            self.columns[name] = len(self.columns)
            self.integers.append(self.is_integer)
        column = self.columns[name]
        for row, value in self._read_pairs(tokens[1:]):
            self._check_row(row)
            if row == self.cost_row:
                self.costs[column] = value
            elif row in self.rows:
                if (self.rows[row], column) in self.entries:
                    self.fail(f"one entry of column {name} in row {row}", "a second one")
                self.entries[self.rows[row], column] = value

    def _read_pairs(self, tokens: list[str]) -> list[tuple[str, float]]:
        """Return names with their numbers."""
        if not tokens or len(tokens) % 2:
            self.fail("names with a number each", " ".join(tokens))
        return [
            (name, self._read_number(text))
            for name, text in zip(tokens[::2], tokens[1::2], strict=True)
        ]

    def _read_number(self, text: str) -> float:
        """Return a number; those of 1e20 and beyond are infinite."""
        try:
            value = float(text)
        except ValueError:
            self.fail("a number", text)
        if np.isnan(value):
            self.fail("a number", text)
        return float(np.copysign(np.inf, value)) if abs(value) >= _INFINITE else value

    def _check_row(self, row: str) -> None:
        """Check that a row is stated."""
        if row not in self.kinds:
            self.fail("a row that the section ROWS states", row)

    def _find_column(self, name: str) -> int:
        """Return the index of a column."""
        if name not in self.columns:
            self.fail("a column that the section COLUMNS states", name)
        return self.columns[name]

    def _read_bound(self, tokens: list[str]) -> None:
        """Read a bound."""
        kind, *arguments = tokens
        kind = kind.upper()
        if kind in _WITHOUT_VALUE and arguments:
            name = (
                arguments[0]
                if arguments[0] in self.columns and len(arguments) != 3
                else arguments[-1]
            )
            name = arguments[1] if len(arguments) > 1 and arguments[1] in self.columns else name
            column, value = self._find_column(name), 0.0
        elif kind in _WITH_VALUE and len(arguments) in (2, 3):
            column, value = self._find_column(arguments[-2]), self._read_number(arguments[-1])
        else:
            kinds = ", ".join((*_WITH_VALUE, *_WITHOUT_VALUE))
            self.fail(f"a bound ({kinds}), its set, a column and a number", " ".join(tokens))
        if kind in ("LO", "FX", "LI"):
            self.lower[column] = value
        if kind in ("UP", "FX", "UI"):
            self.upper[column] = value
        if kind in ("FR", "MI"):
            self.lower[column] = -np.inf
        if kind in ("FR", "PL"):
            self.upper[column] = np.inf
        if kind == "BV":
            self.lower[column], self.upper[column] = 0.0, 1.0
        if kind in ("BV", "LI", "UI"):
            self.integers[column] = True

    def _read_square(self, tokens: list[str]) -> None:
        """Read an entry of a quadratic form."""
        if len(tokens) != 3:
            self.fail("two columns and a number", " ".join(tokens))
        i, j = self._find_column(tokens[0]), self._find_column(tokens[1])
        value = self._read_number(tokens[2])
        if self.section == "QCMATRIX":
            target = self.curvature.setdefault(self.quadratic_row, {})
            target[i, j] = target.get((i, j), 0.0) + 2.0 * value
            return
        self.P[i, j] = self.P.get((i, j), 0.0) + value
        if self.section in _TRIANGLES and i != j:
            self.P[j, i] = self.P.get((j, i), 0.0) + value

    def build_model(self) -> QuadraticModel:
        """Return the model after ENDATA."""
        n, m = len(self.columns), len(self.rows)
        if not n:
            self.fail("at least one column before ENDATA", "none")
        if self.cost_row is None:
            self.fail("a row of kind N, the cost, before ENDATA", "none")
        q = np.zeros(n)
        q[list(self.costs)] = list(self.costs.values())
        lower, upper = self._build_bounds(n)
        row_lower, row_upper = self._build_ends(m)
        return QuadraticModel(
            name=self.name or self.path.stem,
            variables=tuple(self.columns),
            lower=lower,
            upper=upper,
            integer=np.array(self.integers),
            P=self._build_symmetric(self.P, n),
            q=q,
            constant=-self.sides.get(self.cost_row, 0.0),
            maximise=self.maximise,
            rows=tuple(self.rows),
            A=_build_matrix(self.entries, (m, n)),
            row_lower=row_lower,
            row_upper=row_upper,
            curvature={
                row: self._build_symmetric(entries, n) for row, entries in self.curvature.items()
            },
        )

    def _build_bounds(self, n: int) -> tuple[Array, Array]:
        """Return the bounds of columns.

        The defaults are 0 and infinity, and 1 for integers without any bound. A negative upper
        bound alone removes the lower one.
        """
        lower, upper = np.zeros(n), np.full(n, np.inf)
        for column, integer in enumerate(self.integers):
            is_stated = column in self.lower or column in self.upper
            upper[column] = self.upper.get(column, 1.0 if integer and not is_stated else np.inf)
            default = -np.inf if upper[column] < 0.0 else 0.0
            lower[column] = self.lower.get(column, default)
        return lower, upper

    def _build_ends(self, m: int) -> tuple[Array, Array]:
        """Return the ends of rows: right-hand sides with ranges."""
        low, high = np.full(m, -np.inf), np.full(m, np.inf)
        for row, i in self.rows.items():
            kind, side, width = self.kinds[row], self.sides.get(row, 0.0), self.ranges.get(row)
            if kind in "LE":
                high[i] = side
            if kind in "GE":
                low[i] = side
            if width is None:
                continue
            if kind == "L" or (kind == "E" and width < 0.0):
                low[i] = side - abs(width)
            else:
                high[i] = side + abs(width)
        return low, high

    def _build_symmetric(self, entries: Entries, n: int) -> sparse.csr_matrix:
        """Return the symmetric part of a matrix."""
        matrix = _build_matrix(entries, (n, n))
        return sparse.csr_matrix(0.5 * (matrix + matrix.T))


def _build_matrix(entries: Entries, shape: tuple[int, int]) -> sparse.csr_matrix:
    """Return a sparse matrix of entries."""
    if not entries:
        return sparse.csr_matrix(shape)
    i, j = np.array(list(entries)).T
    return sparse.csr_matrix((list(entries.values()), (i, j)), shape=shape)
