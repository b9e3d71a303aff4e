"""What limbs keep from the raw surface that their toe stands on, and from all else of a scan.

Planner and checker measure by code of their own; each case is put to both.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh
from known_surfaces import box, joined, quad, rough_chimney, rough_shaft

import climbplan
from climbplan.arrays import Array
from climbplan.climb.check.anew.capsules import build_capsules
from climbplan.climb.check.scan_links import PoseFootholds as Checked
from climbplan.climb.check.scan_links import judge_scan_links
from climbplan.climb.check.subject import Subject
from climbplan.climb.clearance.raw_surface import ToeContacts, find_nearest_raw
from climbplan.robots.capsules import straight_capsules
from climbplan.robots.model import Robot
from climbplan.scan.raw import RawScan
from climbplan.schema.examples import read_example_data
from climbplan.terrain.raw_surface import NARROW, SLENDER, RawSurface

RADIUS, FLATNESS = 0.025, 0.005
UP = np.array([0.0, 0.0, 1.0])
FLOOR = quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])


def limb(angle_deg: float, toe: Array | None = None) -> Array:
    """(1, 1, 4, 3): a tibia of 37.5 cm at an angle to the floor, the rest far above it."""
    place = np.zeros(3) if toe is None else toe
    angle = np.deg2rad(angle_deg)
    knee = place + 0.375 * np.array([np.cos(angle), 0.0, np.sin(angle)])
    return np.array([[[knee + 0.3 * UP, knee + 0.2 * UP, knee, place]]])


def both(raw: RawScan, points: Array, places: Array, normals: Array) -> tuple[float, float]:
    """Room [m] that planner and checker miss; places and normals: (2, 3), NaN for none."""
    scan = RawSurface(raw.vertices, raw.triangles, FLATNESS, 0.01)
    known = ~np.isnan(places).any(axis=1)
    links = straight_capsules(points, RADIUS)
    found = find_nearest_raw(scan, links, ToeContacts(places[known], normals[known]), 0.0)
    plan = SimpleNamespace(terrain=SimpleNamespace(scan=scan))
    subject = cast("Subject", SimpleNamespace(plan=plan, name_limb=lambda *_: "limb"))
    robot = SimpleNamespace(
        capsules=None, mechanism=None, limb_count=1, joint_count=3, limb_radius=RADIUS
    )
    none = np.zeros(0)
    capsules = tuple(build_capsules(cast("Robot", robot), none, none, none, points))
    check = judge_scan_links(
        "scan.limbs", subject, capsules, Checked(places[None, None], normals[None, None]), str
    )
    return found.missing, check.residual


def standing(
    raw: RawScan, points: Array, normal: Array = UP, place: Array | None = None
) -> tuple[float, float]:
    """The same for a limb that stands where its toe is, or at a place."""
    at = points[0, 0, -1] if place is None else place
    none = np.full(3, np.nan)
    return both(raw, points, np.stack([at, none]), np.stack([normal, np.zeros(3)]))


def kept(missing: tuple[float, float]) -> bool:
    """Whether all room is kept; planner and checker have to agree."""
    planner, checker = (m <= 1e-6 for m in missing)
    assert planner == checker, missing
    return planner


@pytest.mark.parametrize("angle", [90, 45, 23, 15])
def test_a_limb_may_lean_over_the_surface_that_it_stands_on(angle: float) -> None:
    assert kept(standing(FLOOR, limb(angle)))


@pytest.mark.parametrize("angle", [0, 3, 8])
def test_a_limb_that_lies_along_its_wall_is_refused(angle: float) -> None:
    assert not kept(standing(FLOOR, limb(angle)))


def test_the_least_angle_is_that_of_the_cone() -> None:
    """Where the cone is as wide as the limb its axis is as high, but for pieces of the cone."""
    least = np.rad2deg(np.arcsin(RADIUS / ((RADIUS + FLATNESS) / SLENDER)))
    assert kept(standing(FLOOR, limb(least + 2)))
    assert not kept(standing(FLOOR, limb(least - 0.5)))


@pytest.mark.parametrize("toe", [FLATNESS, -FLATNESS])
def test_a_toe_may_be_off_the_surface_by_its_flatness(toe: float) -> None:
    assert kept(standing(FLOOR, limb(25, np.array([0, 0, toe]))))


def test_a_toe_that_stands_elsewhere_gives_no_leave() -> None:
    points = limb(23)
    assert kept(standing(FLOOR, points))
    assert not kept(standing(FLOOR, points, place=np.array([0.5, 0.0, 0.0])))
    assert not kept(standing(FLOOR, points, normal=-UP))
    none = np.full((2, 3), np.nan)
    assert not kept(both(FLOOR, points, none, np.zeros((2, 3))))


def test_a_rib_beside_the_toe_is_not_what_it_stands_on() -> None:
    """Upright at 15 mm from the tibia: half an inch more than its own floor may be near."""
    away = 0.015
    rib = box((-0.2, away, 0), (0.4, away + 0.05, 0.3))
    assert not kept(standing(joined(FLOOR, rib), limb(60)))
    far = box((-0.2, 0.026, 0), (0.4, 0.1, 0.3))
    assert kept(standing(joined(FLOOR, far), limb(60)))


@pytest.mark.parametrize("normal", [1.0, -1.0])
def test_a_ledge_above_is_not_what_it_stands_on(normal: float) -> None:
    """A plate with no side faces, 10 cm up, faces as the floor does; its edge is 20 mm away."""
    corners = [(-0.5, 0.02, 0.1), (0.5, 0.02, 0.1), (0.5, 0.4, 0.1), (-0.5, 0.4, 0.1)]
    plate = quad(corners if normal > 0 else corners[::-1])
    assert not kept(standing(joined(FLOOR, plate), limb(80)))


def test_the_other_wall_of_a_crack_is_kept_off() -> None:
    """4 cm wide: a tibia upright in it has 20 mm on each side, in a crack of 6 cm it has room."""
    for wide, allowed in ((0.02, False), (0.03, True)):
        x = wide
        crack = joined(
            FLOOR,
            quad([(-x, -1, 0), (-x, 1, 0), (-x, 1, 0.3), (-x, -1, 0.3)]),
            quad([(x, -1, 0), (x, -1, 0.3), (x, 1, 0.3), (x, 1, 0)]),
        )
        assert kept(standing(crack, limb(90))) == allowed


def test_a_bump_under_the_tibia_is_kept_off() -> None:
    """A pyramid 12 cm from the toe that rises to the axis; one that ends far below it may stay."""
    for top, allowed in ((0.05, False), (0.015, True)):
        peak, half = (0.11, 0.0, top), 0.04
        foot = [(0.11 + a * half, b * half, 0.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        sides = [(foot[i], foot[(i + 1) % 4], peak) for i in range(4)]
        vertices = np.array([c for side in sides for c in side], float)
        bump = RawScan(vertices, np.arange(12).reshape(4, 3), np.zeros(4, np.int64))
        assert kept(standing(joined(FLOOR, bump), limb(25))) == allowed


def test_knees_keep_their_radius_from_what_the_toe_stands_on() -> None:
    """A limb that bends back: its knee comes down to the floor beyond the cone."""
    points = limb(40)
    points[0, 0, 1] = [0.5, 0.0, 0.02]
    assert not kept(standing(FLOOR, points))


def test_a_swinging_toe_stays_out_but_at_its_contacts() -> None:
    places, normals = np.array([[0.0, 0, 0], [0.3, 0, 0]]), np.stack([UP, UP])
    for x, z, allowed in (
        (0.0, 0.001, True),
        (0.3, 0.001, True),
        (0.15, -0.001, False),  # through the floor midway: nothing stands there
        (0.15, 0.03, True),
    ):
        points = limb(60, np.array([x, 0.0, z]))
        assert kept(both(FLOOR, points, places, normals)) == allowed, (x, z)


@pytest.mark.parametrize("seed", range(3))
def test_planner_and_checker_agree_on_random_rock(seed: int) -> None:
    rng = np.random.default_rng(seed)
    raw, decided = rough_chimney(), []
    normal = np.array([1.0, 0.0, 0.0])
    for _ in range(60):
        toe = raw.corners[rng.integers(200)].mean(axis=0)
        way = rng.normal(size=3) + normal
        knee = toe + 0.375 * way / np.linalg.norm(way)
        points = np.array([[[knee + 0.3 * normal, knee + 0.2 * normal, knee, toe]]])
        planner, checker = standing(raw, points, normal)
        if abs(max(planner, 0) - max(checker, 0)) > 2e-3:
            # pieces differ: the larger one may be by what a cone gains over a piece
            assert (planner > 0) == (checker > 0)
        decided.append(planner > 1e-6)
    assert 3 < sum(decided) < 57  # both happen


def test_rule_and_statement_are_one() -> None:
    assert NARROW < (RADIUS + FLATNESS) / SLENDER == pytest.approx(0.12)


@pytest.mark.parametrize(
    ("name", "raw"), [("climb_rough_chimney", rough_chimney), ("mission_rough_shaft", rough_shaft)]
)
def test_shipped_scans_are_those_stated(name: str, raw: Any, tmp_path: Path) -> None:
    for file, data in read_example_data(name).items():
        (tmp_path / file).write_bytes(data)
        shipped = trimesh.load_mesh(tmp_path / file)
        corners = raw().corners
        assert np.allclose(shipped.triangles, corners, atol=1e-6)


@pytest.mark.slow
def test_a_scanned_chimney_is_climbed() -> None:
    plan = climbplan.plan("specs/climb_rough_chimney.yaml")
    assert plan.verify().passed


@pytest.mark.slow
def test_a_mission_in_a_scan_is_planned_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = Path("specs/mission_rough_shaft.yaml").resolve()
    monkeypatch.chdir(tmp_path)
    plan = climbplan.plan(spec)
    assert plan.verify().passed
    assert plan.simulate().passed
