"""Read QPLIB files (Furini et al., "QPLIB: a library of quadratic programming instances", 2019).

The format lists, in this order: name, problem class, sense, sizes, the cost 1/2 x'P x + q'x + c,
the rows' matrices, the number that stands for infinity, ends of rows, bounds, kinds of variables,
a starting point with multipliers, and names. Each list begins with a default value and the number
of entries that differ from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.reading import read_text
from climbplan.solvers.model_files.quadratic_model import (
    MAX_BYTES,
    MAX_ROWS,
    MAX_VARIABLES,
    QuadraticModel,
)

_COSTS, _KINDS, _ROWS = "LDCQ", "CBMIG", "NBLDCQ"
_COMMENTS = ("#", "%", "!")


def read_qplib(path: Path) -> QuadraticModel:
    """Read a QPLIB file.

    Args:
        path: The file.

    Raises:
        UsageError: It cannot be read, is too large, or a line is not what the format wants there.
    """
    text = read_text(path, MAX_BYTES, "a QPLIB file")
    return _QplibReader(path, text.splitlines()).read_model()


@dataclass
class _QplibReader:
    """The lines of a file, and the one that is read next."""

    path: Path
    lines: list[str]
    number: int = 0  # of the last line that was read, from 1

    def read_model(self) -> QuadraticModel:
        """Read the whole file."""
        name = self._read_tokens("the name of the instance", 1)[0]
        kind = self._read_tokens("a class of three letters, such as QBL", 1)[0]
        if len(kind) != 3 or not all(
            letter in letters for letter, letters in zip(kind, (_COSTS, _KINDS, _ROWS), strict=True)
        ):
            self._fail(f"a class of three letters of {_COSTS}, {_KINDS} and {_ROWS}", kind)
        sense = self._read_tokens("minimize or maximize", 1)[0].lower()
        if sense not in ("minimize", "maximize"):
            self._fail("minimize or maximize", sense)
        n = self._read_count("the number of variables", MAX_VARIABLES, 1)
        m = self._read_count("the number of rows", MAX_ROWS) if kind[2] not in "NB" else 0
        P = sparse.csr_matrix((n, n))
        if kind[0] != "L":
            P = self._read_symmetric("P", n)
        q, constant = self._read_vector("q", n), self._read_number("the constant of the cost")
        curvature = self._read_curvature(n, m) if m and kind[2] in "DCQ" else {}
        A = self._read_matrix(m, n) if m else sparse.csr_matrix((0, n))
        infinity = self._read_number("the number that stands for infinity")
        if not infinity > 0:
            self._fail("a number > 0 that stands for infinity", f"{infinity:g}")
        low, high = (self._read_vector(end, m) if m else np.zeros(0) for end in ("c_l", "c_u"))
        lower, upper = np.zeros(n), np.ones(n)
        if kind[1] != "B":
            lower, upper = self._read_vector("x_l", n), self._read_vector("x_u", n)
        integer = np.full(n, kind[1] in "BI")
        if kind[1] in "MG":
            integer = self._read_kinds(n, lower, upper)
        for size, label in ((n, "initial x"), (m, "initial y"), (n, "initial z")):
            if size:
                self._read_vector(label, size)
        variables = self._read_names("variable", "x", n)
        rows = self._read_names("row", "c", m)
        for ends in (low, high, lower, upper):
            ends[ends >= infinity] = np.inf
            ends[ends <= -infinity] = -np.inf
        return QuadraticModel(
            name, variables, lower, upper, integer, P, q, constant, sense == "maximize",
            rows, A, low, high, curvature,
        )  # fmt: skip

    def _fail(self, expected: str, text: str) -> NoReturn:
        """Raise the error of the last line that was read."""
        raise UsageError(f"{self.path}:{self.number}: expected {expected}, got {text[:60]!r}")

    def _read_tokens(self, expected: str, count: int) -> list[str]:
        """Return the first tokens of the next line with content; the rest is a comment."""
        while self.number < len(self.lines):
            line = self.lines[self.number]
            self.number += 1
            tokens = line.split()
            if tokens and not tokens[0].startswith(_COMMENTS):
                if len(tokens) < count:
                    self._fail(expected, line)
                return tokens[:count]
        raise UsageError(f"{self.path}:{self.number}: the file ends; expected {expected}")

    def _read_entries(
        self, expected: str, count: int, limits: tuple[int, ...]
    ) -> tuple[IntArray, Array]:
        """Read lines of indices from 1, each up to its limit, and a number.

        Returns:
            (count, k) indices from 0, and (count,) numbers.
        """
        if count > len(self.lines) - self.number:
            self._fail(f"as many lines as entries of {expected}", f"{count} entries")
        indices, values = np.zeros((count, len(limits)), np.int64), np.zeros(count)
        for k in range(count):
            *places, value = self._read_tokens(f"{expected}: indices and a number", len(limits) + 1)
            for position, (text, limit) in enumerate(zip(places, limits, strict=True)):
                indices[k, position] = self._convert_index(text, expected, limit) - 1
            values[k] = self._convert(float, value, f"a number of {expected}")
        return indices, values

    def _convert_index(self, text: str, expected: str, limit: int) -> int:
        """Return an index from 1 to a limit."""
        index = self._convert(int, text, f"an index of {expected}")
        if not 1 <= index <= limit:
            self._fail(f"an index of {expected} from 1 to {limit}", text)
        return int(index)

    def _convert(self, kind: Callable[[str], float], text: str, expected: str) -> float:
        """Return a number that a word states."""
        try:
            number = kind(text)
        except ValueError:
            self._fail(expected, text)
        if np.isnan(number):
            self._fail(expected, text)
        return number

    def _read_number(self, expected: str) -> float:
        """Read a line with one number."""
        return float(self._convert(float, self._read_tokens(expected, 1)[0], expected))

    def _read_count(self, expected: str, limit: int, minimum: int = 0) -> int:
        """Read a line with a size."""
        text = self._read_tokens(expected, 1)[0]
        count = int(self._convert(int, text, expected))
        if not minimum <= count <= limit:
            self._fail(f"{expected}, from {minimum} to {limit}", text)
        return count

    def _read_vector(self, label: str, size: int) -> Array:
        """Read a default and the entries that differ."""
        vector = np.full(size, self._read_number(f"the default of {label}"))
        count = self._read_count(f"the number of other entries of {label}", size)
        indices, values = self._read_entries(label, count, (size,))
        vector[indices[:, 0]] = values
        return vector

    def _read_symmetric(self, label: str, n: int) -> sparse.csr_matrix:
        """Read one triangle of a symmetric matrix."""
        count = self._read_count(f"the number of entries of {label}", n * (n + 1) // 2)
        indices, values = self._read_entries(label, count, (n, n))
        return _build_symmetric(indices, values, n)

    def _read_curvature(self, n: int, m: int) -> dict[int, sparse.csr_matrix]:
        """Read one triangle of each row's symmetric matrix."""
        count = self._read_count("the number of entries of H", m * n * (n + 1) // 2)
        indices, values = self._read_entries("H", count, (m, n, n))
        rows = np.unique(indices[:, 0])
        return {
            int(row): _build_symmetric(
                indices[indices[:, 0] == row, 1:], values[indices[:, 0] == row], n
            )
            for row in rows
        }

    def _read_matrix(self, m: int, n: int) -> sparse.csr_matrix:
        """Read the rows' linear entries."""
        count = self._read_count("the number of entries of A", m * n)
        indices, values = self._read_entries("A", count, (m, n))
        return sparse.csr_matrix((values, (indices[:, 0], indices[:, 1])), shape=(m, n))

    def _read_kinds(self, n: int, lower: Array, upper: Array) -> BoolArray:
        """Read which variables are integers; binaries get their bounds.

        The codes are 0 continuous, 1 integer, 2 binary.
        """
        codes = self._read_vector("kinds of variables", n)
        if (wrong := codes[~np.isin(codes, (0, 1, 2))]).size:
            self._fail("kinds of variables 0, 1 or 2", f"{wrong[0]:g}")
        binary = codes == 2
        lower[binary] = np.maximum(lower[binary], 0.0)
        upper[binary] = np.minimum(upper[binary], 1.0)
        return codes > 0

    def _read_names(self, what: str, letter: str, size: int) -> tuple[str, ...]:
        """Read names that differ from x1, x2, ... or c1, c2, ..."""
        names = [f"{letter}{i + 1}" for i in range(size)]
        count = self._read_count(f"the number of names of {what}s", size)
        for _ in range(count):
            index, name = self._read_tokens(f"index and name of a {what}", 2)
            names[self._convert_index(index, f"{what}s", size) - 1] = name
        if len(set(names)) < size:
            self._fail(f"names of {what}s that differ", "two that are the same")
        return tuple(names)


def _build_symmetric(indices: IntArray, values: Array, n: int) -> sparse.csr_matrix:
    """Build the symmetric H of 1/2 x'H x from the entries of one triangle.

    Files list either triangle. An entry h below the diagonal is one of two of a symmetric matrix,
    and means h x_i x_j. Files with upper triangles state terms of an .lp file, 1/2 h x_i x_j: only
    so is the cost of instances that QPLIB lists as convex positive semidefinite.
    """
    i, j = indices[:, 0], indices[:, 1]
    values = np.where(i < j, 0.5 * values, values)
    off = i != j
    places = np.concatenate([i, j[off]]), np.concatenate([j, i[off]])
    return sparse.csr_matrix((np.concatenate([values, values[off]]), places), shape=(n, n))
