"""Measured stiffness of one limb as read from a CSV file, in either of two forms.

A table has one stiffness matrix a row (columns Kxx, Kxz, Kzz, of a spatial test also Kxy, Kyy,
Kyz). Tests have one load step a row: `test`, imposed displacements dx, dy, dz and forces fx, fy, fz
of the axes that were measured, and `axis` (the axis loaded) where it cannot be told from the
displacements. Both say the posture by joint angles (femur_deg, tibia_deg, and coxa_deg of a spatial
test; of other limbs all, by their joints' names), or a table by `r`, how far the foot is from the
femur joint. Units stand in the column names (r_mm, Kxx_N_per_mm, dx_mm, fx_N); `gain` is the
motors' P gain. Frame of the limb: x outward, z up, y across, or that of the body
(`limb_model.py`); forces act on the limb.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import SpecError, SpecMistake, UsageError
from climbplan.reading import read_text, reading

AXES = "xyz"
_UNITS = {
    "m": 1.0, "mm": 1e-3, "in": 0.0254, "inch": 0.0254, "rad": 1.0, "deg": np.pi / 180, "N": 1.0,
    "N_per_m": 1.0, "N_per_mm": 1e3, "": 1.0,
}  # fmt: skip
_LENGTHS, _TURNS = ("m", "mm", "in", "inch"), ("rad", "deg")
_COLUMN = r"(K[xyz]{2}|[df][xyz]|r|gain|%s)(?:_(.+))?"
_MAX_BYTES = 20_000_000


@dataclass(frozen=True)
class AngleColumns:
    """The angles that describe the posture of a limb."""

    names: tuple[str, ...]  # of its joints, from the body to the toe
    # The angle that a test in the limb's plane does not feel; None: the limb has no plane, and all
    # angles are needed
    across: str | None
    slides: frozenset[str] = frozenset()  # those that are lengths

    def unit(self, name: str) -> str:
        """Return the usual unit of its column."""
        return "mm" if name in self.slides else "deg"

    def list_required(self, axes: tuple[int, ...]) -> set[str]:
        """Return the columns that tests along axes require."""
        in_plane = self.across is not None and 1 not in axes
        return set(self.names) - ({self.across} if in_plane and self.across else set())


COXA_FEMUR_TIBIA = AngleColumns(("coxa", "femur", "tibia"), "coxa")


@dataclass(frozen=True)
class MeasuredPosture:
    """The posture of the limb: joint angles, or only the distance of its foot."""

    angles: Array | None  # (j,) [rad]
    distance: float | None  # [m] of the foot from the femur joint


@dataclass(frozen=True)
class Matrix:
    """One stiffness matrix at one posture."""

    name: str
    posture: MeasuredPosture
    gain: float | None  # P gain of the motors, if the file tells it
    stiffness: Array  # (a, a) over the measured axes, column = displaced axis [N/m]
    deviation: Array  # (a, a) standard deviation known from the data, 0 if unknown [N/m]
    line: int  # of the file


@dataclass(frozen=True)
class Series:
    """One loading along one axis; its first row is the preload."""

    test: str
    axis: int  # position in the measured axes
    posture: MeasuredPosture
    gain: float | None
    displacement: Array  # (s,) along the axis [m]
    force: Array  # (s, a) [N]
    line: int


@dataclass(frozen=True)
class Measurements:
    """The contents of a file: matrices, or the loadings to compute them from."""

    axes: tuple[int, ...]  # measured axes of the limb frame, 0 x to 2 z
    matrices: tuple[Matrix, ...]
    series: tuple[Series, ...]
    skipped: tuple[str, ...]  # rows left out, and why


@dataclass(frozen=True)
class _TableRow:
    line: int
    number: dict[str, float]
    text: dict[str, str]


@dataclass(frozen=True)
class _Sheet:
    rows: tuple[_TableRow, ...]
    columns: frozenset[str]
    skipped: tuple[str, ...]
    resolution: dict[str, float]  # half a unit of the last digit printed, by column


def read_measurements(path: Path, angles: AngleColumns = COXA_FEMUR_TIBIA) -> Measurements:
    """Read the measurements in a CSV file; lines that begin with # are comments.

    Rows with a value that is missing or no number are left out and listed.

    Raises:
        UsageError: The file cannot be read.
        SpecError: Its columns make neither a table nor tests.
    """
    sheet = _read_sheet(path, angles)
    tables = [name for name in sheet.columns if name.startswith("K")]
    axes = tuple(a for a in range(3) if any(AXES[a] in name[1:] for name in tables))
    if not tables:
        axes = tuple(a for a in range(3) if f"d{AXES[a]}" in sheet.columns)
    _require_columns(path, sheet.columns, tables, axes, angles)
    if tables:
        matrices = tuple(_read_matrix(row, axes, sheet.resolution, angles) for row in sheet.rows)
        return Measurements(axes, matrices, (), sheet.skipped)
    series, skipped = _group_series(sheet.rows, axes, angles)
    return Measurements(axes, (), tuple(series), (*sheet.skipped, *skipped))


def _read_sheet(path: Path, angles: AngleColumns) -> _Sheet:
    """Read the rows of a file that have all numbers."""
    expected = "a CSV file of stiffness measurements"
    lines = read_text(path, _MAX_BYTES, expected).splitlines()
    used_lines = [(n, text) for n, text in enumerate(lines, 1) if text.strip() and text[0] != "#"]
    if len(used_lines) < 2:
        raise UsageError(f"{path}: holds no rows, expected {expected}")
    with reading(path, expected):  # a quoted cell does not go on in the next line
        cells = [row for _, text in used_lines for row in csv.reader([text])]
    names, scales = _parse_columns(path, used_lines[0][0], cells[0], angles)
    rows, skipped = [], []
    digits: dict[str, int] = {}
    for (line, _), values in zip(used_lines[1:], cells[1:], strict=True):
        text = {name: v.strip() for name, v in zip(names, values, strict=False) if name}
        number = {name: _parse_number(text.get(name, "")) * scale for name, scale in scales.items()}
        bad = [name for name, value in number.items() if not np.isfinite(value)]
        if bad or len(values) != len(names):
            skipped.append(f"line {line}: {', '.join(bad) or 'columns'} missing or no number")
            continue
        for name in scales:
            digits[name] = max(digits.get(name, 0), len(text[name].partition(".")[2]))
        rows.append(_TableRow(line, number, text))
    if not rows:
        raise UsageError(f"{path}: no row is usable; {skipped[0]}")
    resolution = {name: scales[name] * 0.5 * 10.0**-count for name, count in digits.items()}
    return _Sheet(tuple(rows), frozenset([*scales, *names]), tuple(skipped), resolution)


def _parse_columns(
    path: Path, line: int, header: Sequence[str], angles: AngleColumns
) -> tuple[list[str], dict[str, float]]:
    """Return names without units, and by number column the factor to SI units."""
    names, scales, mistakes = [], {}, []
    longest_first = sorted(angles.names, key=len, reverse=True)
    column = re.compile(_COLUMN % "|".join(map(re.escape, longest_first)))
    for cell in (cell.strip() for cell in header):
        match = column.fullmatch(cell)
        if match is None:
            names.append(cell)
            continue
        name, unit = match[1], match[2] or ""
        if unit not in _UNITS:
            known_units = ", ".join(u for u in _UNITS if u)
            mistakes.append(
                SpecMistake(
                    cell, f"unit {unit!r} is not known, expected one of {known_units}", line
                )
            )
        elif name in angles.names and unit in (_TURNS if name in angles.slides else _LENGTHS):
            kind = "slides" if name in angles.slides else "turns"
            expected = f"{name}_{angles.unit(name)}"
            mistakes.append(SpecMistake(cell, f"the joint {kind}; expected {expected}", line))
        elif name in scales:
            mistakes.append(SpecMistake(cell, f"a second column {name}", line))
        else:
            scales[name] = _UNITS[unit]
        names.append(name)
    if mistakes:
        raise SpecError(str(path), mistakes)
    return names, scales


def _require_columns(
    path: Path,
    columns: frozenset[str],
    tables: Sequence[str],
    axes: tuple[int, ...],
    angles: AngleColumns,
) -> None:
    """Raise SpecError for columns that are missing."""
    missing = []
    if axes not in ((0, 2), (0, 1, 2)):
        missing.append("Kxx, Kxz, Kzz of a table or dx, dz, fx, fz of tests (with y: all three)")
    elif tables:
        pairs = {f"K{AXES[a]}{AXES[b]}" for a in axes for b in axes}
        upper = {p for p in pairs if p[1] <= p[2]}
        missing += sorted(upper - columns)
    else:
        missing += sorted({f"f{AXES[a]}" for a in axes} - columns)
        missing += [] if "test" in columns else ["test"]
    needed = angles.list_required(axes)
    by_distance = tables and "r" in columns and 1 not in axes and angles.across is not None
    if not needed <= columns and not by_distance:
        missing += [f"{name}_{angles.unit(name)}" for name in sorted(needed - columns)]
    if missing:
        raise SpecError(str(path), [SpecMistake(name, "column is missing") for name in missing])


def _parse_number(text: str) -> float:
    """Return the number of a cell, NaN for none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _read_posture(row: _TableRow, angles: AngleColumns) -> MeasuredPosture:
    """Return the posture of a row."""
    if set(angles.names) - {angles.across} <= set(row.number):
        return MeasuredPosture(np.array([row.number.get(name, 0.0) for name in angles.names]), None)
    return MeasuredPosture(None, row.number["r"])


def _read_matrix(
    row: _TableRow, axes: tuple[int, ...], resolution: dict[str, float], angles: AngleColumns
) -> Matrix:
    """Return the matrix of a row."""
    size = len(axes)
    stiffness, deviation = np.empty((size, size)), np.empty((size, size))
    for i, a in enumerate(axes):
        for j, b in enumerate(axes):
            name = f"K{AXES[a]}{AXES[b]}"
            if name not in row.number:
                name = f"K{AXES[b]}{AXES[a]}"
            stiffness[i, j] = row.number[name]
            # Rounded numbers are uniform over the last digit.
            deviation[i, j] = resolution[name] / np.sqrt(3)
    name = row.text.get("test") or row.text.get("row") or f"line {row.line}"
    posture, gain = _read_posture(row, angles), row.number.get("gain")
    return Matrix(name, posture, gain, stiffness, deviation, row.line)


def _group_series(
    rows: Sequence[_TableRow], axes: tuple[int, ...], angles: AngleColumns
) -> tuple[list[Series], list[str]]:
    """Group the rows of each test and loaded axis, in their order."""
    displacement_names = ["d" + AXES[a] for a in axes]
    groups: dict[tuple[str, int], list[_TableRow]] = {}
    skipped: list[str] = []
    tests: dict[str, list[_TableRow]] = {}
    for row in rows:
        tests.setdefault(row.text["test"], []).append(row)
    for test, members in tests.items():
        if "axis" not in members[0].text:
            for row, axis in zip(
                members, _find_loaded_axes(members, displacement_names), strict=True
            ):
                groups.setdefault((test, axis), []).append(row)
            continue
        for row in members:
            axis_name = row.text["axis"].lower()
            if len(axis_name) != 1 or axis_name not in AXES or AXES.index(axis_name) not in axes:
                skipped.append(f"line {row.line}: axis {axis_name!r} is none of those measured")
                continue
            groups.setdefault((test, axes.index(AXES.index(axis_name))), []).append(row)
    series = []
    for (test, axis), members in groups.items():
        displacement = np.array([row.number[displacement_names[axis]] for row in members])
        if len(members) < 3 or np.ptp(displacement) == 0:
            skipped.append(f"test {test}, axis {AXES[axes[axis]]}: fewer than 3 different steps")
            continue
        force = np.array([[row.number["f" + AXES[a]] for a in axes] for row in members])
        first = members[0]
        posture, gain = _read_posture(first, angles), first.number.get("gain")
        series.append(Series(test, axis, posture, gain, displacement, force, first.line))
    return series, skipped


def _find_loaded_axes(rows: Sequence[_TableRow], names: Sequence[str]) -> list[int]:
    """Return the axis that each row of a test loads; a row at rest starts the next loading."""
    start = rows[0].number
    axes: list[int] = []
    axis = 0
    for row in reversed(rows):
        change = [abs(row.number[name] - start[name]) for name in names]
        axis = int(np.argmax(change)) if max(change) > 0 else axis
        axes.append(axis)
    return axes[::-1]
