"""Scans that claim or expand to more than memory holds, or whose headers hold other types."""

from __future__ import annotations

import resource
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mutation_sources import npy_of_shape, png_of_size
from PIL import Image, TiffImagePlugin

from climbplan.scan import cleaning, heights
from climbplan.scan.cleaning import find_unique_rows
from climbplan.scan.raw import RawScan, ScanError
from climbplan.scan.reading import read_scan
from climbplan.schema.terrain.scan import ScanSpec


def _pcd(count: str) -> bytes:
    return (
        f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nWIDTH 10\nHEIGHT 1\nPOINTS 10\n"
        "DATA binary\n"
    ).encode() + bytes(1000)


def _tif(path: Path, tags: dict[int, tuple[int, Any]]) -> None:
    table = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, (kind, value) in tags.items():
        table.tagtype[tag], table[tag] = kind, value
    Image.new("F", (20, 20), 0.5).save(path, tiffinfo=table)


def _glb(path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    corners = np.random.default_rng(0).random((30, 3))
    faces = np.repeat(np.arange(10)[:, None], 3, axis=1)
    trimesh.Trimesh(corners, faces, process=False).export(path)


_SQUARE = {33550: (12, (0.1, 0.1, 0.0))}
_HEADER = b"(" * 60_000 + b"\n"
BROKEN: dict[str, tuple[str, bytes | Callable[[Path], None], str]] = {
    "22 TiB": ("a.npy", npy_of_shape((10**12, 3), "<f8"), "not a NumPy array of numbers"),
    "open bracket": (
        "a.npy",
        npy_of_shape((3, 3), "<f8").replace(b"(3, 3)", b"(3, 3'"),
        "not a NumPy array of numbers",
    ),
    "brackets": (
        "a.npy",
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(_HEADER)) + _HEADER,
        "not a NumPy array of numbers",
    ),
    "no numbers a field": ("a.pcd", _pcd("0 1 1"), "COUNT 0 in the PCD header, expected 1"),
    "digits": ("a.pcd", _pcd("1 1 " + "9" * 500), "a number of 500 digits"),
    "scale as text": ("a.tif", lambda p: _tif(p, {33550: (2, "abc")}), "expected 2 numbers"),
    "one scale": ("a.tif", lambda p: _tif(p, {33550: (12, (0.1,))}), "expected 2 numbers"),
    "scale as count": ("a.tif", lambda p: _tif(p, {33550: (3, 0)}), "expected 2 numbers"),
    "tie as text": (
        "a.tif",
        lambda p: _tif(p, {**_SQUARE, 33922: (2, "abcdefgh")}),
        "ModelTiepoint is 'abcdefgh', expected 5 numbers",
    ),
    "collapsed faces": ("a.glb", _glb, "no triangle has an area, expected a surface"),
    "uneven rows": ("a.csv", b"1,2,3\n4,5\n", "Line #2 (got 2 columns instead of 3)"),
    "a long name": (f"{'x' * 300}.stl", lambda _: None, "cannot be read: File name too long"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_headers_are_refused(tmp_path: Path, name: str) -> None:
    file, content, words = BROKEN[name]
    path = tmp_path / file
    if callable(content):
        content(path)
    else:
        path.write_bytes(content)
    with pytest.raises(ScanError) as caught:
        read_scan(ScanSpec(file=str(path)), Path())
    assert words in str(caught.value)


def test_pictures_that_expand_are_thinned(tmp_path: Path) -> None:
    """24 kB that become 25 million heights, which as triangles took 5.4 GB."""
    path = tmp_path / "a.png"
    path.write_bytes(png_of_size(5000, 4999, bytes(5001 * 4999)))
    assert path.stat().st_size < 30_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    raw = heights.read_heights(path, ScanSpec(file=str(path), cell=0.01))
    assert len(raw.vertices) <= heights.MAX_USED_HEIGHTS
    assert "of 4999 x 5000 heights every 8th row and column taken" in raw.notes[0]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**20  # [KiB]


def test_a_part_of_large_maps_keeps_its_details(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heights, "MAX_USED_HEIGHTS", 300)
    path = tmp_path / "a.npy"
    np.save(path, np.random.default_rng(0).random((60, 60)))
    crop = {"lower": (1.0, 2.0, -1.0), "upper": (1.5, 2.5, 2.0)}
    spec = ScanSpec.model_validate({"file": str(path), "cell": 0.1, "crop": crop})
    part = heights.read_heights(path, spec)
    assert len(part.vertices) == 64  # 6 x 6 within it, and one around
    assert not part.notes
    assert len(heights.read_heights(path, ScanSpec(file=str(path), cell=0.1)).vertices) <= 300


def test_distinct_rows_are_those_of_numpy() -> None:
    rows = np.random.default_rng(0).integers(-2, 3, (500, 3))
    distinct, number = find_unique_rows(rows)
    same, other = np.unique(rows, axis=0, return_inverse=True)
    assert (distinct == same).all()
    assert (number == other.reshape(-1)).all()
    none = cleaning.merge_corners(RawScan(np.eye(3), np.zeros((2, 3), int), np.zeros(2, int)))
    assert len(none.triangles) == 0
