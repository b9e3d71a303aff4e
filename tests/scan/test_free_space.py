"""Free space about the body's way: clear of triangles, and as wide as they let it be."""

from __future__ import annotations

import numpy as np
import pytest
from known_surfaces import box, joined, plate

from climbplan.scan.free_space import inflate_free_space, split_path
from climbplan.terrain.solids import Solid

HULL = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])


def test_a_way_is_cut_into_pieces_that_join() -> None:
    pieces = split_path(np.array([[0, 0, 0], [1, 0, 0], [1, 0.1, 0.0]]))
    np.testing.assert_allclose(pieces[1:, 0], pieces[:-1, 1])
    assert np.linalg.norm(np.diff(pieces, axis=1), axis=-1).max() <= 0.4 + 1e-9


def test_free_space_holds_the_sweep_and_no_triangle() -> None:
    walls = joined(box((0.3, -1, -1), (0.5, 1, 1)), box((-1, -1, -0.5), (1, 1, -0.3)))
    ends = np.array([[0, 0, 0], [0.0, 0.3, 0.1]])
    found = inflate_free_space(ends, HULL, walls.corners)
    assert found.min_clearance == pytest.approx(0.2, abs=1e-6)
    solid = Solid.from_points("free", found.vertices)
    sweep = np.concatenate([end + HULL for end in ends])
    assert (sweep @ solid.A.T <= solid.b + 1e-6).all()
    assert found.vertices[:, 0].max() == pytest.approx(0.3, abs=1e-5)
    assert found.vertices[:, 2].min() >= -0.3 - 1e-5
    shrunk = walls.corners + 1e-4 * (walls.corners - ends.mean(axis=0))
    inside = (shrunk.reshape(-1, 3) @ solid.A.T <= solid.b - 1e-5).all(axis=1)
    assert not inside.any()


def test_a_way_through_the_surface_has_no_room() -> None:
    raw = plate().raw
    middle = raw.vertices.mean(axis=0)
    ends = middle + np.array([[0, 0, -0.2], [0, 0, 0.2]])
    assert inflate_free_space(ends, HULL, raw.corners).min_clearance <= 0
