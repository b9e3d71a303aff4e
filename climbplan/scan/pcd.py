"""Point clouds in the PCD format of the Point Cloud Library: ASCII and binary."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from climbplan.arrays import Array
from climbplan.reading import reading
from climbplan.scan.raw import ScanError

_MAX_POINTS = 100_000_000
_MAX_DIGITS = 12  # of a number in the header
_TYPES = {"F": "f", "I": "i", "U": "u"}


def read_pcd(path: Path) -> tuple[Array, Array | None]:
    """Read points (P, 3) and normals (P, 3), None where the file has none.

    Raises:
        ScanError: The file is no PCD cloud.
    """
    with path.open("rb") as file:
        header = _read_header(file)
        body = file.read()
    names = header.get("FIELDS", [])
    if "DATA" not in header or not {"x", "y", "z"} <= set(names):
        raise ScanError(f"{path}: not a PCD cloud, expected a header with FIELDS x y z and DATA")
    try:
        sizes = [_parse_count(s) for s in header["SIZE"]]
        counts = [_parse_count(c) for c in header.get("COUNT", ["1"] * len(names))]
        types = [_TYPES[t.upper()] for t in header["TYPE"]]
        points = _parse_count(header["POINTS"][0])
        columns = list(zip(names, types, sizes, counts, strict=True))
        dtype = np.dtype([(f"{i} {n}", f"<{t}{s}", (c,)) for i, (n, t, s, c) in enumerate(columns)])
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise ScanError(
            f"{path}: expected a PCD header with sound SIZE, TYPE, POINTS ({error})"
        ) from error
    if min(counts) < 1:
        raise ScanError(f"{path}: COUNT {min(counts)} in the PCD header, expected 1 or more")
    if not 0 < points <= _MAX_POINTS or not 0 < dtype.itemsize <= 4096:
        raise ScanError(f"{path}: a PCD cloud of {points} points, expected 1 to {_MAX_POINTS}")
    kind = header["DATA"][0].lower() if header["DATA"] else ""
    if kind == "binary":
        if len(body) < points * dtype.itemsize:
            raise ScanError(
                f"{path}: cut off, expected {points} points in {points * dtype.itemsize} bytes, "
                f"got {len(body)}"
            )
        table = np.frombuffer(body, dtype, points)
        fields = {n.split(" ")[1]: table[n][:, 0].astype(float) for n in dtype.names or ()}
    elif kind == "ascii":
        with reading(path, "a PCD cloud of numbers", ScanError):
            data = np.loadtxt(body.decode("ascii", "replace").splitlines(), ndmin=2)
        starts = np.cumsum([0, *counts])
        if data.shape != (points, starts[-1]):
            expected = f"{points} rows of {starts[-1]} numbers"
            raise ScanError(f"{path}: expected {expected}, got {data.shape}")
        fields = {name: data[:, column] for name, column in zip(names, starts, strict=False)}
    else:
        raise ScanError(f"{path}: PCD data are {kind!r}, expected `ascii` or `binary`")
    xyz = np.column_stack([fields[axis] for axis in "xyz"])
    if not {"normal_x", "normal_y", "normal_z"} <= set(fields):
        return xyz, None
    normals = np.column_stack([fields[f"normal_{axis}"] for axis in "xyz"])
    are_unit = (
        np.isfinite(normals).all() and np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 0.1
    )
    return xyz, normals if are_unit else None


def _read_header(file: BinaryIO) -> dict[str, list[str]]:
    """Read the values of each key up to DATA, after which the body begins."""
    header: dict[str, list[str]] = {}
    for _ in range(64):
        line = file.readline(4096)
        tokens = line.decode("ascii", "replace").split()
        if not line:
            break
        if not tokens or tokens[0].startswith("#"):
            continue
        header[tokens[0].upper()] = tokens[1:]
        if tokens[0].upper() == "DATA":
            break
    return header


def _parse_count(text: str) -> int:
    """Return a number of the header; raise ValueError for none, or one of too many digits."""
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)
