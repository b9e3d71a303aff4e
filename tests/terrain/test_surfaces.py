"""Contact surfaces and solids: projections, distances, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_robot
from climbplan.schema.terrain.terrain import TerrainSpec
from climbplan.terrain.model import build_terrain
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Tube


def pentagon(seed: int) -> Region:
    """A random convex pentagon on a random plane."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 5))
    flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=1)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return Region.from_vertices("p", flat @ q.T + rng.normal(size=3), 0.7)


@pytest.mark.parametrize("seed", range(8))
def test_projection_is_the_nearest_point(seed: int) -> None:
    region = pentagon(seed)
    rng = np.random.default_rng(100 + seed)
    point = region.vertices.mean(axis=0) + rng.normal(size=3)
    # Oracle: best convex combination of the corners.
    weights = minimize(
        lambda w: ((w @ region.vertices - point) ** 2).sum(),
        np.full(5, 0.2),
        bounds=[(0, 1)] * 5,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 1},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    ).x
    expected = float(np.linalg.norm(weights @ region.vertices - point))
    assert region.distance(point) == pytest.approx(expected, abs=1e-6)
    foot = region.project(point)
    assert (region.A @ foot <= region.b + 1e-9).all()
    assert region.normal @ foot == pytest.approx(region.offset)


def test_rectangle_has_its_size_and_normal() -> None:
    wall = Region.from_rectangle("w", np.array([1, 2, 3]), np.array([-2.0, 0, 0]), 0.6, 0.4, 1.0)
    np.testing.assert_allclose(wall.normal, [-1, 0, 0])
    np.testing.assert_allclose(np.ptp(wall.vertices, axis=0), [0, 0.6, 0.4])
    np.testing.assert_allclose(wall.vertices.mean(axis=0), [1, 2, 3])


def test_slab_lies_behind_the_surface() -> None:
    region = pentagon(3)
    slab = region.slab()
    middle = region.vertices.mean(axis=0)
    assert slab.face_distance(middle + 0.01 * region.normal) == pytest.approx(0.01)
    assert slab.face_distance(middle - 0.01 * region.normal) < 0
    assert slab.face_distance(middle - 0.10 * region.normal) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "empty"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]], "not flat"),
        ([[0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0]], "not convex"),
        ([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]], "empty"),
        ([[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]], "same corner twice"),
    ],
)
def test_malformed_polygons_are_refused(vertices: list[list[float]], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Region.from_vertices("bad", np.array(vertices, float), 1.0)


def test_tube_projects_outward_and_faces_inward() -> None:
    tube = Tube("t", np.array([0.1, 0.0]), 0.6, -1.0, 1.0, 1.0)
    foot = tube.project(np.array([0.4, 0.0, 2.0]))
    np.testing.assert_allclose(foot, [0.7, 0.0, 1.0])
    np.testing.assert_allclose(tube.normal_at(foot), [-1, 0, 0])
    assert tube.distance(foot) == 0


def test_box_and_hull_agree() -> None:
    box = Solid.from_box("b", np.zeros(3), np.array([1.0, 2.0, 3.0]))
    hull = Solid.from_points("h", box.vertices)
    assert len(hull.b) == 6
    points = np.random.default_rng(0).uniform(-1, 4, (200, 3))
    np.testing.assert_allclose(box.face_distance(points), hull.face_distance(points), atol=1e-9)


def test_flat_solid_is_refused() -> None:
    with pytest.raises(UsageError, match="no volume"):
        Solid.from_points("f", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]))


@pytest.mark.parametrize(
    ("shift", "friction", "warned"),
    [(0.0, 0.1, True), (0.0, 1.0, False), (0.6, 0.1, False), (0.5, 0.1, False)],
)
def test_overlapping_patches_of_other_friction_are_warned_of(
    shift: float, friction: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """A patch inside a region is warned of, one beside it or of the same friction is not."""
    robot = Robot.from_spec(load_robot("silvia"))

    def patch(name: str, y: float, size: float, mu: float) -> dict[str, object]:
        flat = {"center": [0.6, y, 0.0], "normal": [-1, 0, 0], "width": size, "height": size}
        return {"name": name, "rectangle": flat, "friction": mu}

    regions = [patch("wall", 0.0, 0.8, 1.0), patch("ice", shift, 0.2, friction)]
    spec = TerrainSpec.model_validate({"friction": 1.0, "regions": regions})
    assert len(build_terrain(spec, robot).regions) == 2
    assert ("'wall' and 'ice' overlap" in caplog.text) == warned
