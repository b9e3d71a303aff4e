"""Meshes such as benchmarks of other projects have, each from one spec as a new user writes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from trimesh.transformations import rotation_matrix

import climbplan

SPEC = """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  scan: {{file: {file}, steepest_deg: 40}}
task:
  rounds: auto
  start: {{com: {start}, rpy_deg: [0, 0, -90]}}
  goal: {{com: {goal}, rpy_deg: [0, 0, -90]}}
  stance: {{RF: [0.25, 0.42, -0.28], RM: [0.44, 0, -0.28], RR: [0.25, -0.42, -0.28],
    LR: [-0.25, -0.42, -0.28], LM: [-0.44, 0, -0.28], LF: [-0.25, 0.42, -0.28]}}
solver: {{time_limit: 900}}
"""


def block(lower: tuple[float, ...], upper: tuple[float, ...]) -> trimesh.Trimesh:
    size = np.subtract(upper, lower)
    return trimesh.creation.box(size).apply_translation(np.add(lower, upper) / 2)


def tilted_blocks() -> trimesh.Trimesh:
    """Blocks of 0.4 m between two floors, each tilted by 15 degrees to one of four sides."""
    parts = [block((-1.5, -1.5, -0.1), (0.2, 1.5, 0)), block((2.6, -1.5, -0.1), (4, 1.5, 0))]
    sides = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]
    for i in range(6):
        for j in range(-3, 4):
            own = trimesh.creation.box([0.4, 0.4, 0.3])
            own.apply_transform(rotation_matrix(np.deg2rad(15), sides[(i + j) % 4]))
            top = 0.15 + 0.05 * (i in (2, 3))
            parts.append(own.apply_translation([0.4 + 0.4 * i, 0.4 * j, top - 0.17]))
    return trimesh.util.concatenate(parts)


def floor_with_a_hole() -> trimesh.Trimesh:
    """One sheet with a hole of 0.5 m by 0.3 m on the way."""
    hole = [(0.8, -0.15), (0.8, 0.15), (1.3, 0.15), (1.3, -0.15)]
    floor = shapely.Polygon([(-2, -2), (4, -2), (4, 2), (-2, 2)], [hole])
    corners = [
        np.array(piece.exterior.coords)[2::-1]
        for piece in shapely.constrained_delaunay_triangles(floor).geoms
    ]
    vertices = np.concatenate([np.column_stack([c, np.zeros(3)]) for c in corners])
    return trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "start", "goal"),
    [
        (tilted_blocks, "[-0.6, 0, 0.28]", "[1.4, 0, 0.45]"),
        (floor_with_a_hole, "[-0.3, 0, 0.28]", "[2.3, 0, 0.28]"),
    ],
)
def test_a_hexapod_crosses_it(make, start: str, goal: str, tmp_path: Path) -> None:
    make().export(tmp_path / "ground.stl")
    path = tmp_path / "cross.yaml"
    path.write_text(SPEC.format(file="ground.stl", start=start, goal=goal))
    assert climbplan.plan(path).verify().passed
