"""Contact regions against surfaces whose standable area is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from known_surfaces import ROOM, SURFACES, Known, angle, block, grid, holed, plate, sunk, tube

from climbplan.scan.cleaning import clean_mesh
from climbplan.scan.contact_regions import FoundRegion, find_contact_regions
from climbplan.scan.convex import decompose_convex, extract_convex_pieces
from climbplan.scan.courses import Course, make_blocks, make_rubble
from climbplan.scan.distances import compute_triangle_distances
from climbplan.scan.raw import RawScan
from climbplan.schema.terrain.scan import ScanSpec

SPEC = ScanSpec(file="unread", toe_radius=ROOM)
LEAST_COVERAGE = 0.85
LARGEST_COVERAGE = 1.06  # known areas leave out what rounding and mild edges add


def sampled(region: FoundRegion, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of a convex polygon: its corners, mixed."""
    weights = rng.dirichlet(np.full(len(region.vertices), 0.7), count)
    return weights @ region.vertices


def covered_area(raw: RawScan, regions: tuple[FoundRegion, ...], count: int) -> float:
    """Area of the raw surface that some region lies on, by points drawn on it."""
    rng = np.random.default_rng(0)
    corners = raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1) / 2
    which = rng.choice(len(area), count, p=area / area.sum())
    share = rng.dirichlet((1, 1, 1), count)
    points = np.einsum("sk,skj->sj", share, corners[which])
    hit = np.zeros(count, bool)
    for region in regions:
        edges = np.roll(region.vertices, -1, axis=0) - region.vertices
        out = np.cross(edges, region.normal)
        inside = (points @ out.T - (out * region.vertices).sum(axis=1) <= 1e-9).all(axis=1)
        near = np.abs((points - region.vertices[0]) @ region.normal) <= SPEC.flatness + 1e-9
        hit |= inside & near & (doubled[which] @ region.normal > 0)
    return float(hit.mean() * area.sum())


@pytest.mark.parametrize(
    "surface",
    [
        pytest.param(s, marks=[pytest.mark.slow] if s.__name__ in ("dome", "waves") else [])
        for s in SURFACES
    ],
)
def test_regions_cover_what_is_there_within_the_flatness(surface) -> None:
    known: Known = surface()
    raw = clean_mesh(known.raw)
    regions = find_contact_regions(raw, SPEC)
    share = covered_area(raw, regions, 20_000) / known.area
    assert LEAST_COVERAGE <= share <= LARGEST_COVERAGE

    rng = np.random.default_rng(1)
    for region in regions:
        points = np.concatenate([region.vertices, sampled(region, 1000, rng)])
        low, high = region.vertices.min(axis=0) - 0.02, region.vertices.max(axis=0) + 0.02
        near = (raw.corners.min(axis=1) <= high) & (raw.corners.max(axis=1) >= low)
        near = raw.corners[near.all(axis=1)]
        off = compute_triangle_distances(points, points, near, 1.0)
        assert off.max() <= SPEC.flatness + 1e-9


@pytest.mark.parametrize("surface", [block, holed, tube, sunk])
def test_the_order_of_triangles_and_corners_changes_nothing(surface) -> None:
    raw = surface().raw
    rng = np.random.default_rng(5)
    shuffled = rng.permutation(len(raw.triangles))
    renamed = rng.permutation(len(raw.vertices))
    other = replace(
        raw,
        vertices=raw.vertices[np.argsort(renamed)],
        triangles=np.roll(renamed[raw.triangles][shuffled], 1, axis=1),
    )
    first, second = (find_contact_regions(clean_mesh(r), SPEC) for r in (raw, other))
    assert len(first) == len(second)
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.vertices, two.vertices)


def test_regions_keep_the_toes_radius_from_edges_and_holes() -> None:
    for region in find_contact_regions(clean_mesh(holed().raw), SPEC):
        away = np.abs(region.vertices[:, :2])
        assert (1.0 - away.max(axis=1) >= ROOM - 1e-6).all()
        edges = shapely.Polygon(region.vertices[:, :2])
        hole = shapely.Point(0, 0).buffer(0.3 * np.cos(np.pi / 64), quad_segs=64)
        assert edges.distance(hole) >= ROOM - 1e-3


def test_no_region_lies_within_a_body_that_stands_in_the_ground() -> None:
    for region in find_contact_regions(clean_mesh(sunk().raw), SPEC):
        if region.normal[2] > 0.9 and abs(region.middle[2]) < 1e-6:
            x, y = region.middle[:2]
            assert not (0 < x < 0.5 and 0 < y < 0.4)


def test_faces_that_look_up_from_under_a_plate_are_no_place_for_toes() -> None:
    low = plate().raw
    high = replace(low, vertices=low.vertices + np.array([0, -0.018, 0.024]))  # 30 mm above
    both = replace(
        low,
        vertices=np.concatenate([low.vertices, high.vertices]),
        triangles=np.concatenate([low.triangles, high.triangles + len(low.vertices)]),
        label=np.concatenate([low.label, low.label]),
    )
    regions = find_contact_regions(clean_mesh(both), SPEC)
    covered = sum(r.area for r in regions)
    assert covered == pytest.approx(plate().area, rel=0.12)  # of the upper one alone, nearly


def test_steep_regions_can_be_left_out() -> None:
    raw = clean_mesh(block().raw)
    level = find_contact_regions(raw, SPEC.model_copy(update={"steepest_deg": 40.0}))
    assert [r.normal[2] for r in level] == [pytest.approx(1.0)]
    assert len(find_contact_regions(raw, SPEC)) == 6


def test_convex_pieces_fill_a_polygon_with_a_hole() -> None:
    outline = shapely.Polygon(
        [(0, 0), (4, 0), (4, 3), (2, 3), (2, 2), (0, 2)],
        [[(1, 0.5), (1, 1), (1.5, 1), (1.5, 0.5)]],
    )
    pieces = [shapely.Polygon(p) for p in decompose_convex(outline)]
    assert sum(p.area for p in pieces) == pytest.approx(outline.area)
    assert shapely.union_all(pieces).symmetric_difference(outline).area < 1e-9
    for piece in pieces:
        assert piece.convex_hull.area == pytest.approx(piece.area)
    large = [shapely.Polygon(p) for p in extract_convex_pieces(outline, 3, 0.1)]
    assert len(large) == 3
    assert all(outline.buffer(1e-5).contains(p) for p in large)
    assert large[0].area >= 0.4 * outline.area


def test_an_angle_is_two_regions_at_most() -> None:
    assert len(find_contact_regions(clean_mesh(angle().raw), SPEC)) <= 3


@pytest.mark.slow
def test_two_hundred_thousand_triangles_become_regions() -> None:
    line = np.linspace(0, 4, 317)
    rng = np.random.default_rng(1)
    phase, high = rng.uniform(0, 6, 12), rng.uniform(0.005, 0.02, 12)
    waves = rng.uniform(1, 6, (12, 2))

    def height(u, v):
        return sum(
            a * np.sin(f[0] * u + f[1] * v + p) for a, f, p in zip(high, waves, phase, strict=True)
        )

    raw = grid(line, line, height)
    regions = find_contact_regions(clean_mesh(raw), SPEC)
    assert len(raw.triangles) > 199_000
    assert len(regions) > 100


@pytest.mark.parametrize(
    "course",
    [
        make_blocks(np.random.default_rng(3), 0.33, 3, 0.016),
        make_rubble(np.random.default_rng(4), 3, (0.0, 0.03), 0.2),
    ],
)
def test_spherical_feet_meet_nothing_beside_where_they_stand(course: Course) -> None:
    """Steps lower than a foot's radius are no edges for points, but a sphere meets them."""
    radius, rng = 0.02, np.random.default_rng(0)
    mesh = course.mesh
    label = np.zeros(len(mesh.faces), int)
    raw = clean_mesh(RawScan(np.array(mesh.vertices), np.array(mesh.faces), label))
    spec = SPEC.model_copy(update={"toe_radius": radius})

    def measure_depth(foot_radius: float) -> float:
        depth = 0.0
        for region in find_contact_regions(raw, spec, foot_radius):
            middle = np.concatenate([region.vertices, sampled(region, 300, rng)])
            middle = middle + radius * region.normal
            distance = compute_triangle_distances(middle, middle, raw.corners, 1.0)
            depth = max(depth, radius - float(distance.min()))
        return depth

    assert measure_depth(radius) <= 1e-3
    assert measure_depth(0.0) > 4e-3
