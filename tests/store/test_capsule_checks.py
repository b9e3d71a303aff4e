"""Links are as thick as the robot says: distances of segments, and plans that come too close."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from example_climb import Climb
from hypothesis import given, settings
from hypothesis import strategies as st

from climbplan.climb.check.convex import (
    ConvexBody,
    bound_hull_distance,
    build_hull,
    measure_chain_separation,
)
from climbplan.climb.check.distances import (
    find_body_edges,
    measure_chain_distance,
    measure_motion_distance,
)
from climbplan.climb.check.subject import build_subject
from climbplan.climb.check.verification import verify
from climbplan.climb.plan.file import write_climb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.terrain.model import build_terrain
from climbplan.verification.check import Check

SEEDS = st.integers(0, 2**32 - 1)
RADIUS = 0.025


def body(draw: np.random.Generator) -> ConvexBody:
    """A box or the hull of a few points."""
    if draw.random() < 0.5:
        x, y, z = draw.uniform(0.05, 0.4, 3)
        corners = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)])
    else:
        corners = draw.uniform(-0.3, 0.3, (8, 3))
    return build_hull("body", corners)


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_segment_distances_are_the_least_distances(seed: int) -> None:
    draw = np.random.default_rng(seed)
    solid = body(draw)
    starts, ends = draw.uniform(-0.8, 0.8, (2, 60, 3))
    ends[:20] = starts[:20] + draw.uniform(-0.5, 0.5, (20, 1)) * np.eye(3)[draw.integers(0, 3, 20)]
    chains = np.stack([starts, ends], axis=-2)
    distance = measure_chain_distance(chains, solid, np.inf)[:, 0]
    exact = np.array([bound_hull_distance(chain, solid.corners) for chain in chains])
    apart = exact > 1e-9
    np.testing.assert_allclose(distance[apart], exact[apart], atol=1e-9)
    meeting = measure_chain_separation(chains, solid, 0.0)[:, 0] < 0
    assert (distance[meeting] <= 0).all()


@settings(max_examples=15, deadline=None)
@given(SEEDS, st.floats(0.0, 0.2))
def test_bounds_settle_whether_there_is_enough_room(seed: int, enough: float) -> None:
    draw = np.random.default_rng(seed)
    solid = body(draw)
    chains = draw.uniform(-0.8, 0.8, (20, 4, 3))
    exact, bounded = (measure_chain_distance(chains, solid, e) for e in (np.inf, enough))
    assert (bounded <= exact + 1e-12).all()
    np.testing.assert_array_equal(bounded >= enough, exact >= enough)


@settings(max_examples=15, deadline=None)
@given(SEEDS, st.sampled_from([0.05, 0.3, np.inf]))
def test_the_least_distance_of_a_motion_is_exact(seed: int, enough: float) -> None:
    draw = np.random.default_rng(seed)
    solid = body(draw)
    phase = np.linspace(0.0, 3.0, 200)[:, None, None]
    middle, swing = draw.uniform(-0.6, 0.6, (2, 2, 3))
    segments = middle + swing * np.sin(phase + draw.uniform(0.0, 6.0, (2, 3)))
    exact = measure_chain_distance(segments, solid, np.inf)[:, 0]
    bounds = measure_motion_distance(segments, solid, enough)
    assert (bounds <= exact + 1e-12).all()
    assert (bounds >= min(exact.min(), enough) - 1e-12).all()
    segments[70, 0, 1] = np.nan
    assert np.isnan(measure_motion_distance(segments, solid, enough)[70])


def test_a_point_is_a_segment_and_nan_stays() -> None:
    solid = build_hull(
        "cube", np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    )
    assert len(find_body_edges(solid)) == 12
    corner = np.array([1.3, 1.4, 1.0])
    chain = np.stack([corner, corner])
    assert measure_chain_distance(chain, solid, np.inf) == pytest.approx(0.5, abs=1e-12)
    chain = np.array([[0.5, 0.5, 3.0], [np.nan, 0.0, 3.0]])
    assert np.isnan(measure_chain_distance(chain, solid, 0.1)).all()


def checks_under_a_lid(climb: Climb, height: float, path: Path) -> dict[str, Check]:
    """Checks of the example below a wide lid at a height, which its spec asks for as well."""
    document = yaml.safe_load(climb.plan.spec_text)
    lid = {"name": "lid", "lower": [-0.6, -0.9, height], "upper": [0.6, 0.9, height + 0.2]}
    document["terrain"]["obstacles"].append(lid)
    text = yaml.safe_dump(document)
    terrain = build_terrain(ClimbSpec.model_validate(document).terrain, climb.plan.robot)
    sha = hashlib.sha256(text.encode()).hexdigest()
    write_climb(replace(climb.plan, terrain=terrain, spec_text=text, spec_sha256=sha), path)
    return {check.name: check for check in verify(path).checks}


@pytest.mark.parametrize(("gap", "passes"), [(0.020, False), (0.0249, False), (0.0251, True)])
def test_a_knee_closer_than_the_limb_radius_is_refused(
    climb: Climb, gap: float, passes: bool, tmp_path: Path
) -> None:
    assert climb.plan.robot.limb_radius == RADIUS
    points = build_subject(climb.plan).limbs.points  # (K, N, 4, 3)
    knee = points[..., 2, 2]
    assert knee.max() == points[..., 2].max()  # knees are what is highest
    checks = checks_under_a_lid(climb, float(knee.max()) + gap, tmp_path / "plan.h5")
    check = checks["limbs.collision"]
    assert check.passed == passes
    assert check.residual == pytest.approx(RADIUS - gap, abs=1e-9)
    limb = climb.plan.robot.limb_names[int(knee.max(axis=0).argmax())]
    assert "lid" in check.worst_at
    assert f"{limb} femur" in check.worst_at or f"{limb} tibia" in check.worst_at
    assert checks["limbs.axis_collision"].passed  # the axes alone are clear
    if not passes:
        assert f"{1e3 * (RADIUS - gap):.1f} mm too close" in check.margin


def test_a_swing_closer_than_the_limb_radius_is_refused(climb: Climb, tmp_path: Path) -> None:
    highest = build_subject(climb.plan).limbs.points[..., 2].max()
    # Clear at every instant; knees rise further while toes swing between them
    low = checks_under_a_lid(climb, float(highest) + 0.0251, tmp_path / "plan.h5")
    high = checks_under_a_lid(climb, float(highest) + 0.2, tmp_path / "other.h5")
    assert low["limbs.collision"].passed
    assert high["limbs.collision"].passed
    assert high["trajectory.collision"].passed
    assert low["trajectory.collision"].residual > high["trajectory.collision"].residual
