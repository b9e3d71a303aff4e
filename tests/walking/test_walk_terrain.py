"""Convex footholds: polygons, slopes, stepping stones, gaps; and what their check finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from climbplan.schema.robots.rigid_body import RigidBodySpec
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.check.terrain import compute_clearance_height
from climbplan.walking.kernels.swept_terrain import compute_swing_heights
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram
from climbplan.walking.offline.gaits import assign_regions, repeat_gait
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.offline.sqp import build_iterate, solve_gait
from climbplan.walking.planner.gaps import compute_max_toe_distance, find_widest_gap
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.regions import build_ground, sample_stones
from climbplan.walking.schema.loading import load_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.terrain import SteppingStonesSpec
from climbplan.walking.task.facts import build_facts, read_facts
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import Goal, WalkTask, WalkTrajectory

RAMP = {
    "regions": [
        {"name": "floor", "x": [-1, 0.25], "y": [-0.5, 0.5]},
        {
            "name": "ramp",
            "corners": [[0.25, -0.5, 0], [0.9, -0.5, 0.13], [0.9, 0.5, 0.13], [0.25, 0.5, 0]],
        },
        {"name": "top", "x": [0.9, 3], "y": [-0.5, 0.5], "height": 0.13},
    ]
}
BANKS = [
    {"name": "near", "x": [-0.6, 0.25], "y": [-0.4, 0.4]},
    {"name": "far", "x": [0.55, 1.6], "y": [-0.4, 0.4]},
]
FAR_AWAY = {"name": "far away", "x": [3, 4], "y": [0, 1]}
STONES = {"x": [0.26, 0.54], "y": [-0.3, 0.3], "pitch": 0.12, "size": 0.09, "turn_deg": 12}


def stated(terrain: dict[str, Any], **task: Any) -> WalkTask:
    given = {"start": {"velocity": [0.5, 0, 0]}, "reference": {"velocity": [0.5, 0, 0]}}
    document = {"kind": "mpc", "terrain": terrain, "task": {"min_contacts": 2, **given, **task}}
    return build_task(MpcSpec.model_validate(document), scaler())


@cache
def scaler() -> RigidBodySpec:
    return load_body("scaler")


@cache
def up_the_ramp() -> tuple[WalkTask, WalkTrajectory]:
    task = stated(RAMP, knots=14, start={"velocity": [0.6, 0, 0], "position": [0.2, 0]})
    gait = assign_regions(task, repeat_gait("walking trot", 4, task.knots))
    found = solve_gait(task, gait, None, 40)
    assert found.trajectory is not None
    assert found.is_feasible
    return task, found.trajectory


@cache
def across_stones() -> tuple[WalkTask, WalkTrajectory]:
    terrain = {"regions": BANKS, "stones": {**STONES, "rise": 0.02, "seed": 3}}
    task = stated(terrain, knots=15, goal={"position": [0.6, 0], "within": 0.1})
    answer = search(task, SearchLimits(60.0, qps=60))
    assert answer.trajectory is not None
    return task, answer.trajectory


def failed(task: WalkTask, found: WalkTrajectory) -> set[str]:
    return {check.name for check in check_trajectory(task, found) if not check.passed}


def test_a_ramp_is_walked_up_with_cones_about_its_normal() -> None:
    task, found = up_the_ramp()
    assert format_failures(check_trajectory(task, found)) == ""
    on_ramp = found.gait.contact & (found.gait.region == 1)
    assert on_ramp.sum() > 8
    spots = found.toes[on_ramp]
    np.testing.assert_allclose(spots[:, 2], 0.2 * (spots[:, 0] - 0.25), atol=1e-9)


def test_a_slippery_ramp_lets_go_as_its_cones_say() -> None:
    """Upright cones of 0.15 would hold the body on a rise of 0.2; those about normals do not."""
    still = {"velocity": [0, 0, 0]}
    task = stated(
        {**RAMP, "friction": 0.15},
        knots=5, start={**still, "position": [0.58, 0]}, reference=still,
        workspace_over_stance=False,
    )  # fmt: skip
    found = solve_gait(
        task, assign_regions(task, repeat_gait("stand", 4, task.knots)), None, 40
    ).trajectory
    assert found is not None
    assert (found.gait.region == 1).all()
    assert "force.friction" not in failed(task, found)
    slides = 9.81 * (0.2 - 0.15) / (1 + 0.15 * 0.2)  # [m/s^2] at least, with the height kept
    assert found.state[-1, 3] < -0.5 * slides * 5 * task.dt
    upright = replace(task.ground, slope=np.zeros_like(task.ground.slope))
    held = found.force.copy()
    held[:-1] = [0.0, 0.0, task.weight / 4]
    kept = replace(found, force=held)
    assert "force.friction" in failed(task, kept)
    assert "force.friction" not in failed(replace(task, ground=upright), kept)


def test_stones_are_crossed_and_every_change_is_found() -> None:
    task, found = across_stones()
    assert format_failures(check_trajectory(task, found)) == ""
    names = [task.ground.names[r] for r in found.gait.region[found.gait.contact]]
    assert sum(name.startswith("S") for name in names) > 6
    assert found.state[-1, 0] > 0.5 - 1e-4
    knots, legs = np.nonzero(found.gait.contact & (found.gait.region > 1))
    n, leg = int(knots[0]), int(legs[0])
    toes = found.toes.copy()
    toes[n, leg, :2] = task.ground.inner[found.gait.region[n, leg]] + [0.08, 0.0]
    assert "contact.region" in failed(task, replace(found, toes=toes))
    low = found.toes.copy()
    low[~found.gait.contact, 2] -= 0.03
    assert "swing.clearance" in failed(task, replace(found, toes=low))
    farther = Goal(task.goal.lower + 0.5, task.goal.upper + 0.5)
    assert "goal.position" in failed(replace(task, goal=farther), found)


def test_swinging_toes_of_a_tilted_body_begin_over_the_ground_beneath() -> None:
    """Not before their heights are known: far below they would be far aside, over other ground."""
    task, walk = up_the_ramp()
    state = walk.state.copy()
    state[:, 7] -= 0.15
    at = replace(build_iterate(walk, walk.gait), state=state)
    program = FixedContactProgram(task, walk.gait)
    toes = program.compute_toes(at.state, at.spots)
    assert np.linalg.norm(toes[..., :2] - walk.toes[..., :2], axis=-1).max() < 0.2
    assert np.abs(toes[..., 2] - walk.toes[..., 2]).max() < 0.2
    assert program.solve_qp(at) is not None


def test_complementarity_takes_polygons_slopes_and_goals_too() -> None:
    start = {"velocity": [0.6, 0, 0], "position": [0.2, 0]}
    task = stated(RAMP, knots=6, start=start, goal={"position": [0.6, 0], "within": 0.2})
    answer = solve_nlp(task, "walking trot", 60.0)
    assert answer.trajectory is not None
    assert format_failures(check_trajectory(task, answer.trajectory)) == ""
    assert answer.trajectory.state[-1, 0] >= 0.4 - 1e-4


def test_toes_clear_what_lies_between() -> None:
    """From the floor over a wall of 6 cm that nothing stands on to the floor behind."""
    regions = [
        {"name": "floor", "x": [-1, 0.3], "y": [-1, 1]},
        {"name": "wall", "x": [0.31, 0.33], "y": [-1, 1], "height": 0.06},
        {"name": "behind", "x": [0.34, 2], "y": [-1, 1]},
    ]
    ground = build_ground(
        MpcSpec.model_validate({"kind": "mpc", "terrain": {"regions": regions}}).terrain
    )
    toes, contact = np.zeros((4, 4, 3)), np.ones((4, 4), bool)
    toes[:, 0, 0] = [0.25, 0.28, 0.36, 0.40]
    contact[1:3, 0] = False
    region = np.zeros((4, 4), np.int64)
    region[1:, 0] = 2
    kernel = compute_swing_heights(toes, contact, region, ground.region_arrays)
    np.testing.assert_allclose(kernel[1:3, 0], [0.06, 0.06])
    np.testing.assert_allclose(
        compute_clearance_height(ground, toes, contact)[1:3, 0], [0.06, 0.06]
    )


def test_toes_clear_what_they_stood_on_the_edge_of() -> None:
    """Whatever rounding says of a toe on an edge: whether it is on the ground, or just beside."""
    regions = [
        {"name": "step", "x": [-1, 0.3], "y": [-1, 1], "height": 0.05},
        {"name": "floor", "x": [0.4, 2], "y": [-1, 1]},
    ]
    spec = MpcSpec.model_validate({"kind": "mpc", "terrain": {"regions": regions}})
    ground = build_ground(spec.terrain)
    contact = np.ones((3, 4), bool)
    contact[1, 0] = False
    for edge in (0.3, np.nextafter(0.3, 1.0)):
        toes = np.zeros((3, 4, 3))
        toes[:, 0, 0], toes[0, 0, 2] = [edge, 0.35, 0.45], 0.05
        np.testing.assert_allclose(compute_clearance_height(ground, toes, contact)[1, 0], 0.05)


def test_kernel_and_check_agree_on_what_there_is_to_clear() -> None:
    task, found = across_stones()
    rng, ground = np.random.default_rng(2), task.ground
    for _ in range(20):
        toes = found.toes + rng.normal(0, 0.05, found.toes.shape) * [1, 1, 0]
        standing = found.gait.contact
        toes[standing] = found.toes[standing]
        kernel = compute_swing_heights(toes, standing, found.gait.region, ground.region_arrays)
        ours = compute_clearance_height(ground, toes, standing)
        counted = np.isfinite(ours) & ~standing
        assert counted.sum() > 10
        # The kernel counts the region ahead of a leg that does not come down, too
        assert (kernel[counted] >= ours[counted] - 1e-9).all()
        lands = np.array(
            [standing[n:, leg].any() for n, leg in zip(*np.nonzero(counted), strict=True)]
        )
        np.testing.assert_allclose(kernel[counted][lands], ours[counted][lands], atol=1e-9)


def test_geometry_of_regions() -> None:
    triangle = {"name": "t", "corners": [[0, 0, 0], [0, 1, 0.2], [1, 0, 0.1]]}  # clockwise
    spec = MpcSpec.model_validate({"kind": "mpc", "terrain": {"regions": [triangle, FAR_AWAY]}})
    far = replace(build_ground(spec.terrain), friction=0.5)
    zero = np.zeros(5, np.int64)
    points = np.array([[0.2, 0.2], [0.6, 0.6], [-0.1, 0.5], [0.5, -0.3], [0.4, 0.4]])
    np.testing.assert_allclose(far.compute_height(zero, points), points @ [0.1, 0.2], atol=1e-12)
    outside = far.compute_distance_outside(zero, points)
    np.testing.assert_allclose(outside[1:4], [0.2 / np.sqrt(2), 0.1, 0.3], atol=1e-12)
    assert outside[0] < 0
    assert (far.compute_distance_outside(zero, far.project(zero, points)) < 1e-9).all()
    frame = far.frame[0]
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(frame[2] @ [1, 0, 0.1], 0.0, atol=1e-12)


def test_toes_keep_away_from_edges() -> None:
    task, found = across_stones()
    strict = replace(task, ground=replace(task.ground, edge=0.012))
    assert "contact.region" in failed(strict, found)
    answer = search(strict, SearchLimits(60.0, qps=60))
    assert answer.trajectory is not None
    assert format_failures(check_trajectory(strict, answer.trajectory)) == ""
    again = read_facts(build_facts(strict)).ground
    assert again.edge == 0.012
    wide = {"regions": [{"name": "beam", "x": [0, 2], "y": [0, 0.1]}], "edge": 0.06}
    with pytest.raises(ValidationError, match="expected a region wider than twice"):
        MpcSpec.model_validate({"kind": "mpc", "terrain": wide})


def test_fields_of_stones_repeat_and_miss_what_they_say() -> None:
    spec = SteppingStonesSpec(x=(0, 1.2), y=(0, 1.2), missing=0.3, seed=5, rise=0.02)
    names, corners, height = sample_stones(spec)
    every = SteppingStonesSpec(x=(0, 1.2), y=(0, 1.2), missing=0.0, seed=5, rise=0.02)
    all_names, all_corners, _ = sample_stones(every)
    assert len(names) == round(0.7 * len(all_names))
    for name, corner in zip(names, corners, strict=True):
        np.testing.assert_array_equal(corner, all_corners[all_names.index(name)])
    assert (np.abs(height) <= 0.02).all()
    assert corners.min() >= 0.0
    assert corners.max() <= 1.2
    assert sample_stones(spec)[0] == names


@pytest.mark.parametrize(
    ("gap", "contacts", "whole", "proved"),
    [(0.9, 2, True, True), (0.9, 0, True, False), (0.9, 2, False, False), (0.5, 2, True, False)],
)
def test_a_gap_is_too_wide_only_where_no_attitude_reaches(
    gap: float, contacts: int, whole: bool, proved: bool
) -> None:
    banks = [BANKS[0], {"name": "far", "x": [0.25 + gap, 3], "y": [-0.4, 0.4]}]
    task = stated(
        {"regions": banks},
        goal={"position": [1.6, 0]}, min_contacts=contacts, workspace_over_stance=whole,
    )  # fmt: skip
    found = find_widest_gap(task)
    assert found is not None
    assert (found.near_name, found.far_name) == ("near", "far")
    assert found.width == pytest.approx(gap)
    assert found.max_width == pytest.approx(compute_max_toe_distance(task.body))
    assert found.proved == proved
    assert f"{gap:.2f} m between near and far" in str(found)


def test_the_way_of_least_gaps_is_the_one_that_is_told() -> None:
    wide = [*BANKS, {"name": "S1", "x": [0.3, 0.35], "y": [-0.3, 0.3]}]
    found = find_widest_gap(stated({"regions": wide}, goal={"position": [1.4, 0], "within": 0.05}))
    assert found is not None
    assert (found.near_name, found.far_name) == ("S1", "far")
    assert found.width == pytest.approx(0.2)
    touching = [BANKS[0], {"name": "far", "x": [0.25, 1.6], "y": [-0.4, 0.4]}]
    assert find_widest_gap(stated({"regions": touching}, goal={"position": [1.4, 0]})) is None
    nowhere = find_widest_gap(stated({"regions": touching}, goal={"position": [9, 0]}))
    assert nowhere is not None
    assert nowhere.proved
    assert nowhere.far_name == "the goal"


def test_facts_of_rough_ground_are_kept() -> None:
    for task in (across_stones()[0], up_the_ramp()[0]):
        again = read_facts(build_facts(task))
        for name in ("lower", "upper", "height", "slope", "corners"):
            np.testing.assert_array_equal(getattr(again.ground, name), getattr(task.ground, name))
        np.testing.assert_array_equal(again.goal.lower, task.goal.lower)


@pytest.mark.parametrize(
    ("terrain", "message"),
    [
        ({"regions": [{"name": "a", "corners": [[0, 0, 0], [1, 0, 0]]}]}, "3 to 12 corners"),
        (
            {"regions": [{"name": "a", "corners": [[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]]}]},
            "convex polygon",
        ),
        (
            {"regions": [{"name": "a", "corners": [[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]]}]},
            "corners in one plane",
        ),
        (
            {"regions": [{"name": "a", "x": [0, 1], "corners": [[0, 0, 0], [1, 0, 0], [1, 1, 0]]}]},
            "either `corners` or",
        ),
        ({"regions": [{"name": "a", "x": [0, 1], "y": [0, 1], "slope": [2, 0]}]}, "rise of 1"),
        ({"regions": BANKS, "stones": {**STONES, "x": [0.1, 0.5]}}, "overlap region 'near'"),
        ({"stones": {**STONES, "size": 0.12}}, "overlap at a pitch"),
    ],
)
def test_terrain_that_cannot_be(terrain: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        MpcSpec.model_validate({"kind": "mpc", "terrain": terrain})


def test_methods_that_know_level_regions_say_so() -> None:
    document = {"kind": "mpc", "terrain": RAMP, "solver": {"method": "spatial-branch-and-bound"}}
    with pytest.raises(ValidationError, match="level regions"):
        MpcSpec.model_validate(document)


def test_horizons_beyond_a_second_have_answers() -> None:
    """Rounding made their Hessians indefinite in units of forces."""
    task = stated({}, knots=20)
    found = solve_gait(task, assign_regions(task, repeat_gait("walking trot", 4, 20)), None, 12)
    assert found.trajectory is not None
    assert found.is_feasible
    assert found.has_converged


def test_flat_ground_is_one_region_without_end() -> None:
    ground = Ground.flat(0.7)
    assert not ground.is_rough
    assert ground.count == 1
