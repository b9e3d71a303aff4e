"""Walks in the axes of climbs: terrain in their form, y forward, and plans that agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from climbplan.errors import SpecError
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.check.plan_checks import check_plan
from climbplan.walking.check.terrain import compute_region_error
from climbplan.walking.offline.gaits import assign_regions, repeat_gait
from climbplan.walking.plan.axes import orient_plan, orient_task, to_climbing_axes
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.foot_centres import raise_task
from climbplan.walking.planner.planner import plan_walk, solve_task
from climbplan.walking.problem.problem import build_task
from climbplan.walking.problem.regions import build_ground
from climbplan.walking.schema.loading import load_body, load_mpc
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.schema.solver import WalkSolverSpec
from climbplan.walking.task.task import WalkTask

STEPS = [
    {"name": "floor", "x": [-1.0, 0.3], "y": [-0.6, 0.5], "height": 0.01},
    {"name": "ramp", "x": [0.3, 0.6], "y": [-0.6, 0.5], "height": 0.04, "slope": [0.1, 0.05]},
    {
        "name": "top",
        "corners": [[0.6, -0.6, 0.07], [2, -0.6, 0.07], [2, 0.5, 0.07], [0.6, 0.5, 0.07]],
    },
]
CLIMBING_STEPS = [
    {"name": "floor", "x": [-0.5, 0.6], "y": [-1.0, 0.3], "height": 0.01},
    {"name": "ramp", "x": [-0.5, 0.6], "y": [0.3, 0.6], "height": 0.04, "slope": [-0.05, 0.1]},
    {
        "name": "top",
        "corners": [[-0.5, 0.6, 0.07], [0.6, 0.6, 0.07], [0.6, 2, 0.07], [-0.5, 2, 0.07]],
    },
]
GIVEN = {"start": {"velocity": [0.4, 0.1, 0]}, "reference": {"velocity": [0.5, 0, 0]}}
CLIMBING_GIVEN = {"start": {"velocity": [-0.1, 0.4, 0]}, "reference": {"velocity": [0, 0.5, 0]}}


def stated(terrain: dict[str, Any], forward: str = "x", **task: Any) -> MpcSpec:
    document = {"kind": "mpc", "forward": forward, "terrain": terrain, "task": task}
    return MpcSpec.model_validate(document)


def built(spec: MpcSpec) -> WalkTask:
    return build_task(spec, load_body("scaler"))


def test_a_walk_with_y_forward_is_the_walk_with_x_forward() -> None:
    goal = {"position": [0.5, 0.1], "within": 0.2}
    toes = {"LF": [0.2, 0.12]}
    first = built(
        stated(
            {"regions": STEPS},
            start={**GIVEN["start"], "rpy_deg": [3, 4, 5], "toes": toes},
            reference=GIVEN["reference"],
            goal=goal,
        )
    )
    # A body that rolls about its forward axis pitches, in the axes of climbs, about y
    rotation = first.start.state[6:9]
    assert rotation[0] == pytest.approx(np.deg2rad(3))
    second = built(
        stated(
            {"regions": CLIMBING_STEPS},
            "y",
            start={**CLIMBING_GIVEN["start"], "rpy_deg": [0, 0, 5], "toes": {"LF": [-0.12, 0.2]}},
            reference=CLIMBING_GIVEN["reference"],
            goal={"position": [-0.1, 0.5], "within": 0.2},
        )
    )
    for name in ("lower", "upper", "height", "slope", "inner"):
        np.testing.assert_allclose(
            getattr(second.ground, name), getattr(first.ground, name), atol=1e-12
        )
    np.testing.assert_allclose(second.start.toes[0, :2], [0.2, 0.12])
    np.testing.assert_allclose(second.start.state[3:6], first.start.state[3:6])
    np.testing.assert_allclose(second.reference.velocity, first.reference.velocity)
    np.testing.assert_allclose(second.goal.lower, first.goal.lower)
    assert second.start.state[8] == pytest.approx(np.deg2rad(5))


def test_angles_are_those_of_a_body_with_y_forward() -> None:
    """Nose up is a roll about x in climbs, and a negative pitch about y in walks."""
    task = built(stated({}, "y", reference={"rpy_deg": [6, 0, 0]}))
    np.testing.assert_allclose(np.rad2deg(task.reference.euler[0]), [0, -6, 0], atol=1e-12)
    np.testing.assert_allclose(task.reference.velocity[0], [1.8, 0, 0])  # the default is forward
    turned = built(stated({}, "y", reference={"rpy_deg": [0, 7, 20]}))
    np.testing.assert_allclose(np.rad2deg(turned.reference.euler[0]), [7, 0, 20], atol=1e-9)


def test_a_plan_is_in_the_axes_of_its_spec(tmp_path: Path) -> None:
    (tmp_path / "walk.yaml").write_text(
        "kind: mpc\nforward: y\n"
        "terrain: {regions: [{name: floor, x: [-1, 1], y: [-1, 3]}]}\n"
        "task: {knots: 5, start: {velocity: [0, 0.5, 0]}, reference: {velocity: [0, 0.5, 0]}}\n"
        "solver: {method: gait-search, max_qp_solves: 20}\n"
    )
    plan = plan_walk(load_mpc(tmp_path / "walk.yaml"))
    write_walk_plan(plan, tmp_path / "plan.h5")
    stored = read_walk_plan(tmp_path / "plan.h5")
    assert stored.forward == "y"
    failures = [check.name for check in check_plan(stored) if not check.passed]
    assert failures == []
    position = stored.trajectory.state[-1, :3]
    assert position[1] > 0.15
    assert abs(position[0]) < 0.05
    np.testing.assert_allclose(stored.trajectory.state[:, 8], np.pi / 2, atol=0.1)
    np.testing.assert_array_equal(stored.task.ground.upper[0], [1.0, 3.0])


def test_orientation_keeps_everything_but_the_axes() -> None:
    task = built(stated({"regions": STEPS}, **GIVEN))
    turned = orient_task(task, "y")
    np.testing.assert_allclose(turned.start.toes, to_climbing_axes(task.start.toes))
    spots, regions = task.start.toes[:, :2], task.ground.nearest(task.start.toes[:, :2])
    np.testing.assert_allclose(
        turned.ground.compute_height(regions, to_climbing_axes(spots)),
        task.ground.compute_height(regions, spots),
    )
    np.testing.assert_array_equal(turned.ground.nearest(to_climbing_axes(spots)), regions)
    assert orient_task(task, "x") is task
    assert orient_plan.__doc__
    assert raise_task(turned, 0.0).ground.count == 3


def test_regions_of_climbs_are_those_of_walks() -> None:
    rise, level = 0.1, {"normal": [0, 0, 1]}
    length = float(np.hypot(0.3, 0.3 * rise))
    terrain = {
        "friction": 0.8,
        "regions": [
            {
                "name": "floor",
                "rectangle": {"center": [0, 0, 0.01], "width": 2, "height": 1, **level},
            },
            {
                "name": "ramp",
                "rectangle": {
                    "center": [0, 0.65, 0.04],
                    "normal": [0, -rise, 1],
                    "width": 2,
                    "height": length,
                },
            },
            {
                "name": "top",
                "vertices": [[-1, 0.8, 0.055], [1, 0.8, 0.055], [0.5, 2, 0.055]],
                "friction": 0.3,
                "limbs": ["LF", "LH"],
            },
        ],
    }
    spec = stated(terrain, "y")
    ground = build_ground(spec.terrain, 0.0, ("LF", "RF", "LH", "RH"))
    np.testing.assert_allclose(ground.lower[:2], [[-1, -0.5], [-1, 0.5]], atol=1e-12)
    np.testing.assert_allclose(ground.upper[:2], [[1, 0.5], [1, 0.8]], atol=1e-12)
    np.testing.assert_allclose(ground.slope, [[0, 0], [0, rise], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(ground.height[:2], [0.01, 0.04])
    np.testing.assert_allclose(ground.find_friction(np.arange(3)), [0.8, 0.8, 0.3])
    np.testing.assert_array_equal(ground.allowed[2], [True, False, True, False])
    old = build_ground(stated({"regions": STEPS}).terrain)
    assert not old.allowed.size
    assert not old.region_friction.size


def test_ground_and_boxes_of_climbs() -> None:
    terrain = {
        "friction": 1.0,
        "ground": {"height": 0.0, "across": [-1, 1], "along": [-1, 2]},
        "boxes": [{"name": "brick", "lower": [-0.2, 0.5, 0], "upper": [0.2, 0.8, 0.05]}],
    }
    ground = build_ground(stated(terrain, "y").terrain)
    assert ground.names[-1] == "brick"
    assert ground.height[-1] == 0.05
    on_brick = ground.nearest(np.array([[0.0, 0.6], [0.0, 0.4], [0.5, 0.6]]))
    assert ground.names[on_brick[0]] == "brick"
    assert all(ground.height[region] == 0.0 for region in on_brick[1:])
    inside = ground.compute_distance_outside(np.arange(ground.count), np.array([0.0, 0.6]))
    assert (inside < 0).sum() == 1  # none of the ground under the brick


def test_legs_keep_to_their_regions() -> None:
    halves = [
        {"name": "right", "x": [-1, 2], "y": [-0.5, 0], "limbs": ["RF", "RH"]},
        {"name": "left", "x": [-1, 2], "y": [0, 0.5], "limbs": ["LF", "LH"]},
        {"name": "wide", "x": [-1, 2], "y": [0.5, 1.0]},
    ]
    task = built(stated({"regions": halves}, **GIVEN))
    gait = assign_regions(task, repeat_gait("trot", 4, task.knots))
    assert set(gait.region[:, [0, 2]].ravel().tolist()) <= {1, 2}
    assert set(gait.region[:, [1, 3]].ravel().tolist()) == {0}
    errors = compute_region_error(
        task.ground, np.zeros_like(gait.region), np.zeros((*gait.region.shape, 3)), gait.contact
    )
    assert np.isinf(errors[:, [0, 2]]).all()  # left legs on the right half
    assert np.isfinite(errors[:, [1, 3]]).all()


@pytest.mark.parametrize(
    ("region", "line", "words"),
    [
        ("{name: a, rectangle: {center: [0, 0, 0], normal: [1, 0, 0], width: 1, height: 1}}", 4,
         "expected a region that faces up"),
        ("{name: a, vertices: [[0, 0, 0], [0, 1, 0], [1, 1, 0]]}", 4, "anticlockwise"),
        ("{name: a, vertices: [[0, 0, 0], [1, 0, 0], [1, 1, 0.2], [0, 1, 0]]}", 4, "off their"),
        ("{name: a, x: [0, 1], y: [0, 1], vertices: [[0, 0, 0], [1, 0, 0], [1, 1, 0]]}", 4,
         "expected either `vertices` or `x`, got both"),
        ("{name: a, rectangle: {center: [0, 0, 0], normal: [0, -2, 1], width: 1, height: 1}}", 4,
         "expected a rise of 1 at most, got 2.00"),
        ("{name: a, x: [0, 1], y: [0, 1], limbs: [LX]}", 4, "has no leg 'LX'"),
    ],
)  # fmt: skip
def test_mistakes_name_line_and_key(tmp_path: Path, region: str, line: int, words: str) -> None:
    text = f"kind: mpc\nterrain:\n  regions:\n    - {region}\nforward: y\n"
    (tmp_path / "walk.yaml").write_text(text)
    with pytest.raises(SpecError) as caught:
        load_mpc(tmp_path / "walk.yaml")
    said = str(caught.value)
    assert any(f":{line}: terrain.regions.0" in row and words in row for row in said.splitlines())


def test_other_mistakes_of_terrain_and_axes() -> None:
    ground = {"across": [-1, 1], "along": [-1, 1]}
    for terrain, forward, words in (
        ({}, "z", "Input should be 'x' or 'y'"),
        (
            {"ground": ground, "regions": [{"name": "a", "x": [0, 2], "y": [0, 1]}]},
            "y",
            "overlaps `gr",
        ),
        (
            {"ground": ground, "regions": [{"name": "ground", "x": [2, 3], "y": [0, 1]}]},
            "y",
            "differ",
        ),
        ({"scan": {"file": "a.stl", "holds": {}}}, "y", "no `holds`"),
    ):
        with pytest.raises(ValidationError, match=words):
            stated(terrain, forward)


@pytest.mark.parametrize("method", ["gait-search", "mpcc"])
def test_friction_is_that_of_each_region(method: str) -> None:
    """On a slippery strip under the right legs, forces keep to its own cones."""
    halves = [
        {"name": "left", "x": [-1, 2], "y": [0, 0.6]},
        {"name": "right", "x": [-1, 2], "y": [-0.6, 0], "friction": 0.15},
    ]
    task = built(
        stated(
            {"friction": 0.8, "regions": halves},
            knots=5,
            min_contacts=2,
            start={"velocity": [0.3, 0, 0]},
            reference={"velocity": [0.6, 0, 0]},
        )
    )
    answer = solve_task(task, WalkSolverSpec(method=method, max_qp_solves=30))
    found = answer.trajectory
    assert found is not None
    assert format_failures(check_trajectory(task, found)) == ""
    shear = np.hypot(found.force[..., 0], found.force[..., 1])
    slips = shear > 0.16 * found.force[..., 2] + 1e-6
    assert not slips[:, [1, 3]].any()
    swapped = replace(task.ground, region_friction=task.ground.region_friction[::-1] * 0.01)
    failed = check_trajectory(replace(task, ground=swapped), found)
    assert "force.friction" in {check.name for check in failed if not check.passed}
