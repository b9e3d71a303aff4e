"""Meshes of courses to walk over, ahead along y: stairs, rubble, stones, slopes and blocks.

Each begins with a level floor at z = 0 about the origin and ends with a level one, so that a robot
can stand at both ends. The drawn details of a course follow from its random generator alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

_CELL = 0.2  # [m] side of a block of rubble
_NUM_COLUMNS = 12  # of blocks side by side
_MAX_LENGTH = 2.6  # [m] of a way over rubble
_START = 0.45  # [m] along y, where stairs, slopes and blocks begin
_MARGIN = 0.6  # [m] from the end of what is uneven to where the body goes
_END = 1.6  # [m] length of the level floor behind


@dataclass(frozen=True)
class Course:
    """A mesh, and where the body goes from the origin."""

    mesh: trimesh.Trimesh
    length: float  # [m] along y
    rise: float  # [m]

    def write(self, path: Path) -> None:
        """Write the mesh as STL."""
        self.mesh.export(path)


def make_stairs(rise: float, run: float, count: int) -> Course:
    """Make stairs of `count` steps, each `rise` high and `run` deep [m]."""
    boxes = [_make_box([-1, -1.2, -0.1], [1, _START, 0])]
    for k in range(count):
        end = _START + run * (k + 1) + (_END if k == count - 1 else 0.0)
        boxes.append(_make_box([-1, _START + run * k, -0.1], [1, end, rise * (k + 1)]))
    return _join(boxes, _START + run * count + _MARGIN, rise * count)


def make_blocks(draw: np.random.Generator, run: float, count: int, height: float) -> Course:
    """Make `count` blocks across the way, each `run` deep, up to `height` above or below [m]."""
    boxes = [_make_box([-1, -1.2, -height - 0.1], [1, _START, 0])]
    for k in range(count):
        begin = _START + run * k
        top = draw.uniform(-height, height)
        boxes.append(_make_box([-1, begin, -height - 0.1], [1, begin + run, top]))
    end = _START + run * count
    boxes.append(_make_box([-1, end, -height - 0.1], [1, end + _END, 0]))
    return _join(boxes, end + _MARGIN, 0.0)


def make_slope(angle: float, length: float) -> Course:
    """Make a slope of an angle [rad] over a level length [m]; negative angles go down."""
    import trimesh

    rise, bottom = length * float(np.tan(angle)), min(0.0, length * float(np.tan(angle))) - 0.1
    ramp = _make_box([-1, _START, bottom], [1, _START + length, 0])
    corners = ramp.vertices.copy()
    is_raised = (corners[:, 2] > bottom) & (corners[:, 1] > _START + length / 2)
    corners[is_raised, 2] = rise
    boxes = [
        _make_box([-1, -1.2, bottom], [1, _START, 0]),
        trimesh.Trimesh(corners, ramp.faces, process=False),
        _make_box([-1, _START + length, bottom], [1, _START + length + _END, rise]),
    ]
    return _join(boxes, _START + length + _MARGIN, rise)


def make_rubble(
    draw: np.random.Generator, num_rows: int, height: tuple[float, float], tilt: float
) -> Course:
    """Make rows of twelve blocks of uneven height [m], each inclined twice by up to `tilt` [rad].

    The way ends on the blocks where it would be longer than 2.6 m.
    """
    boxes = [_make_box([-1.2, -1.2, -0.1], [1.2, 0.4, 0])]
    for row in range(num_rows):
        for column in range(_NUM_COLUMNS):
            low = np.array([-1.2 + _CELL * column, 0.4 + _CELL * row])
            top, slope = draw.uniform(*height), np.tan(draw.uniform(-tilt, tilt, 2))
            box = _make_box([*low, -0.3], [*(low + _CELL), top])
            corners = box.vertices.copy()
            on_top = corners[:, 2] > top - 1e-9
            corners[on_top, 2] = top + (corners[on_top, :2] - low - _CELL / 2) @ slope
            box.vertices = corners
            boxes.append(box)
    end = 0.4 + _CELL * num_rows
    boxes.append(_make_box([-1.2, end, -0.1], [1.2, end + _END, 0]))
    return _join(boxes, min(end + _MARGIN, _MAX_LENGTH), 0.0)


def make_stones(draw: np.random.Generator, num_rows: int, size: tuple[float, float]) -> Course:
    """Make rows of six stones of a size from and to [m], apart from each other and uneven."""
    y = 0.35
    boxes = [_make_box([-0.8, -1.2, -0.3], [0.8, y, 0])]
    for _ in range(num_rows):
        for column in range(6):
            half = draw.uniform(*size) / 2
            middle = np.array([-0.6 + 0.24 * column, y + 0.14]) + draw.uniform(-0.02, 0.02, 2)
            top = draw.uniform(-0.03, 0.03)
            boxes.append(_make_box([*(middle - half), -0.3], [*(middle + half), top]))
        y += 0.26
    boxes.append(_make_box([-0.8, y + 0.02, -0.3], [0.8, y + _END, 0]))
    return _join(boxes, y + _MARGIN, 0.0)


def _make_box(low: list[float], high: list[float]) -> trimesh.Trimesh:
    import trimesh

    return trimesh.creation.box(bounds=[low, high])


def _join(boxes: list[trimesh.Trimesh], length: float, rise: float) -> Course:
    import trimesh

    mesh = trimesh.util.concatenate(boxes)
    assert isinstance(mesh, trimesh.Trimesh)
    return Course(mesh, length, rise)
