"""Graspable spots of closed bodies: faces, directions of fingers, and what is in their way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from known_surfaces import box, joined, quad

from climbplan.scan.body_holds import (
    BodyHold,
    find_body_holds,
    find_closed_bodies,
    format_body_regions,
)
from climbplan.scan.cleaning import clean_mesh
from climbplan.scan.holds import Grasping
from climbplan.scan.raw import RawScan, ScanError, build_mesh
from climbplan.scan.study import build_scan_spec
from climbplan.schema.terrain.terrain import RegionSpec
from climbplan.terrain.holds import hold_on

SCAN = build_scan_spec(Path("cubes.stl"), [])
CUBE = ((-0.05, -0.05, 0.5), (0.05, 0.05, 0.6))


def found(raw: RawScan, opening: float = 0.11) -> tuple[BodyHold, ...]:
    return find_body_holds(clean_mesh(raw), SCAN, Grasping(opening))


@pytest.mark.slow
def test_a_cube_is_gripped_from_six_faces_in_two_directions_each() -> None:
    holds = found(box(*CUBE))
    assert len(holds) == 12
    for hold in holds:
        assert abs(hold.axis @ hold.normal) < 1e-9
        assert np.abs(hold.axis).max() == pytest.approx(1.0, abs=1e-9)
        assert hold.undercut_deg == pytest.approx(0.0, abs=1e-6)
        assert hold.width == pytest.approx(0.1, abs=1e-6)
        # 5 mm of play along the axis either way, the face less the toe's radius across it
        play = (hold.vertices - hold.vertices.mean(axis=0)) @ hold.axis
        assert 0.002 <= play.max() <= 0.005 + 1e-9


@pytest.mark.slow
def test_what_is_open_or_wider_than_the_opening_is_none() -> None:
    ground = quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    raw = joined(ground, box(*CUBE))
    assert find_closed_bodies(clean_mesh(raw)).sum() == 12
    assert len(found(raw)) == 12
    assert not find_closed_bodies(clean_mesh(ground)).any()
    with pytest.raises(ScanError, match=r"6 contact regions none .* opening of 90 mm"):
        found(raw, opening=0.09)


def test_a_neighbour_stands_in_the_way_of_fingers() -> None:
    """A cube 8 mm beside another: no finger comes between them."""
    raw = joined(box(*CUBE), box((0.058, -0.05, 0.5), (0.158, 0.05, 0.6)))
    for hold in found(raw):
        place = hold.vertices.mean(axis=0)
        between = 0.0 < place[0] < 0.108 and abs(hold.normal[0]) < 0.5
        assert not (between and abs(hold.axis[0]) > 0.5), (place, hold.normal, hold.axis)
        assert not (abs(hold.normal[0]) > 0.5 and 0.04 < place[0] < 0.07)


def test_sides_of_a_wedge_lean_back_as_they_do() -> None:
    """A frustum whose sides lean back by 20 degrees from above, and by as much over from below."""
    raw = box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.06))
    vertices = raw.vertices.copy()
    lean = np.tan(np.deg2rad(20.0))
    vertices[:, :2] -= np.sign(vertices[:, :2]) * vertices[:, 2:] * lean
    holds = found(build_mesh(vertices, raw.triangles))
    above = [h for h in holds if h.normal[2] > 0.9]
    below = [h for h in holds if h.normal[2] < -0.9]
    assert [h.undercut_deg for h in above] == pytest.approx([-20.0] * 2, abs=0.1)
    assert [h.undercut_deg for h in below] == pytest.approx([20.0] * 2, abs=1.0)


def test_holds_are_regions_of_a_spec() -> None:
    holds = found(box(*CUBE))
    for own, hold in zip(format_body_regions(holds, SCAN), holds, strict=True):
        spec = RegionSpec.model_validate(own)
        assert spec.hold is not None
        stated = hold_on(hold.normal, spec.hold)
        assert np.allclose(stated.axis, hold.axis, atol=1e-8)
        assert -1e-3 <= hold.undercut_deg - np.rad2deg(stated.undercut) <= 0.02
