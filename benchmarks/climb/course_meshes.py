"""Meshes of courses made from seeds: stairs, rubble and stepping stones, ahead along y."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

_CELL = 0.2  # [m] side of a block of rubble
_NUM_COLUMNS = 12  # of blocks side by side
_MAX_LENGTH = 2.6  # [m] of a way over rubble


@dataclass(frozen=True)
class Course:
    """A mesh, and where the body goes from the origin."""

    mesh: trimesh.Trimesh
    length: float  # [m] along y
    rise: float  # [m]


def make_stairs(seed: int) -> Course:
    """Make 3 to 8 steps, 0.08 to 0.17 m high and 0.25 to 0.35 m deep."""
    draw = np.random.default_rng(seed)
    rise, run, count = draw.uniform(0.08, 0.17), draw.uniform(0.25, 0.35), int(draw.integers(3, 9))
    boxes = [_make_box([-1, -1.2, -0.1], [1, 0.45, 0])]
    for k in range(count):
        end = 0.45 + run * (k + 1) + (1.6 if k == count - 1 else 0.0)
        boxes.append(_make_box([-1, 0.45 + run * k, -0.1], [1, end, rise * (k + 1)]))
    return _join(boxes, 0.45 + run * count + 0.6, rise * count)


def make_rubble(seed: int) -> Course:
    """Make 100 to 500 blocks of uneven height, each inclined by up to 8 degrees twice."""
    draw = np.random.default_rng(1000 + seed)
    num_rows = max(int(draw.integers(100, 501)) // _NUM_COLUMNS, 8)
    boxes = [_make_box([-1.2, -1.2, -0.1], [1.2, 0.4, 0])]
    for row in range(num_rows):
        for column in range(_NUM_COLUMNS):
            low = np.array([-1.2 + _CELL * column, 0.4 + _CELL * row])
            height, slope = draw.uniform(-0.04, 0.08), np.tan(np.deg2rad(draw.uniform(-8, 8, 2)))
            box = _make_box([*low, -0.3], [*(low + _CELL), height])
            corners = box.vertices.copy()
            on_top = corners[:, 2] > height - 1e-9
            corners[on_top, 2] = height + (corners[on_top, :2] - low - _CELL / 2) @ slope
            box.vertices = corners
            boxes.append(box)
    end = 0.4 + _CELL * num_rows
    boxes.append(_make_box([-1.2, end, -0.1], [1.2, end + 1.6, 0]))
    return _join(boxes, min(end + 0.6, _MAX_LENGTH), 0.0)


def make_stones(seed: int) -> Course:
    """Make 4 to 8 rows of six stones of 0.14 to 0.2 m, apart from each other and uneven."""
    draw = np.random.default_rng(2000 + seed)
    num_rows, y = int(draw.integers(4, 9)), 0.35
    boxes = [_make_box([-0.8, -1.2, -0.3], [0.8, y, 0])]
    for _ in range(num_rows):
        for column in range(6):
            half = draw.uniform(0.14, 0.2) / 2
            middle = np.array([-0.6 + 0.24 * column, y + 0.14]) + draw.uniform(-0.02, 0.02, 2)
            top = draw.uniform(-0.03, 0.03)
            boxes.append(_make_box([*(middle - half), -0.3], [*(middle + half), top]))
        y += 0.26
    boxes.append(_make_box([-0.8, y + 0.02, -0.3], [0.8, y + 1.6, 0]))
    return _join(boxes, y + 0.6, 0.0)


COURSES: dict[str, Callable[[int], Course]] = {
    "stairs": make_stairs,
    "rubble": make_rubble,
    "stones": make_stones,
}


def write_course(kind: str, seed: int, folder: Path) -> tuple[Path, Course]:
    """Write the mesh of a course; return its file and the course."""
    course = COURSES[kind](seed)
    path = folder / f"{kind}{seed}.stl"
    course.mesh.export(path)
    return path, course


def _make_box(low: list[float], high: list[float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def _join(boxes: list[trimesh.Trimesh], length: float, rise: float) -> Course:
    mesh = trimesh.util.concatenate(boxes)
    assert isinstance(mesh, trimesh.Trimesh)
    return Course(mesh, length, rise)
