"""Online on stepping stones: footholds, the loop's record, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.check.checker import check_loop, format_failures
from climbplan.walking.check.terrain import compute_ground_height
from climbplan.walking.kernels.foothold_regions import find_nearest_regions, select_region
from climbplan.walking.online.closed_loop import LoopResult, simulate_loop
from climbplan.walking.online.controller import OnlineController, OnlineSettings, build_horizon_task
from climbplan.walking.online.footholds import (
    compute_reference_clearance,
    flatten_task,
    follow_terrain,
    project_to_footholds,
)
from climbplan.walking.online.library import build_library
from climbplan.walking.online.run import compute_library_key
from climbplan.walking.online.safe_stance import solve_balance_forces
from climbplan.walking.problem.problem import build_sampled_task, build_task
from climbplan.walking.schema.loading import load_body
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import WalkTask

STONES = {
    "edge": 0.01,
    "regions": [
        {"name": "near", "x": [-0.6, 0.25], "y": [-0.4, 0.4]},
        {"name": "far", "x": [0.55, 1.6], "y": [-0.4, 0.4]},
    ],
    "stones": {
        "x": [0.26, 0.54], "y": [-0.3, 0.3], "pitch": 0.12, "size": 0.09,
        "turn_deg": 12, "rise": 0.02, "seed": 3,
    },
}  # fmt: skip
STEPS = {
    "regions": [
        {"name": "floor", "x": [-1, 0.3], "y": [-0.6, 0.6]},
        {"name": "step", "x": [0.3, 3], "y": [-0.6, 0.6], "height": 0.05},
    ]
}

RAMP = {
    "regions": [
        {"name": "floor", "x": [-1, 0.3], "y": [-0.6, 0.6]},
        {"name": "ramp", "x": [0.3, 3], "y": [-0.6, 0.6], "height": 0.135, "slope": [0.1, 0]},
    ]
}


def stated(terrain: dict[str, Any], **more: Any) -> MpcSpec:
    walk = {"start": {"velocity": [0.5, 0, 0]}, "reference": {"velocity": [0.5, 0, 0]}}
    document = {"kind": "mpc", "terrain": terrain, "task": {"min_contacts": 2, **walk}}
    return MpcSpec.model_validate(document | {"solver": {"method": "online"}} | more)


def task_on(terrain: dict[str, Any]) -> WalkTask:
    return build_task(stated(terrain), load_body("scaler"))


@cache
def across() -> tuple[WalkTask, LoopResult]:
    task = task_on(STONES)
    library = build_library(flatten_task(task), 1, 0, gaits=0)
    controller = OnlineController(task, library, OnlineSettings())
    return task, simulate_loop(controller, task, 1.2)


def told(task: WalkTask, loop: LoopResult, **changes: Any) -> str:
    walk = replace(loop.trajectory, **changes)
    whole = build_sampled_task(task, len(walk.state) - 1)
    return format_failures(check_loop(whole, walk, loop.push_velocity))


def test_stones_are_crossed_online_and_every_change_is_found() -> None:
    task, loop = across()
    walk = loop.trajectory
    assert loop.fall_time is None
    assert walk.state[-1, 0] > 0.4
    assert told(task, loop) == ""
    on_stones = walk.gait.contact & (walk.gait.region > 1)
    assert len(np.unique(walk.gait.region[on_stones])) >= 3
    assert np.abs(walk.toes[on_stones][:, 2]).max() > 1e-3  # stones are higher and lower
    toes = walk.toes.copy()
    toes[..., 0] += np.where(on_stones, 0.05, 0.0)
    assert "contact.region" in told(task, loop, toes=toes)
    sunk = walk.toes.copy()
    sunk[..., 2] -= np.where(walk.gait.contact, 0.0, 0.08)
    assert "swing.penetration" in told(task, loop, toes=sunk)


def test_compiled_regions_are_those_of_the_ground() -> None:
    task = task_on(STONES)
    ground, body = task.ground, task.body
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.7, -0.5], [1.7, 0.5], (300, 2))
    found = find_nearest_regions(points, ground.lower, ground.upper, ground.sides)
    np.testing.assert_array_equal(found, ground.nearest(points))
    every = np.arange(ground.count)
    for wanted in rng.uniform([0.2, -0.3], [0.6, 0.3], (20, 2)):
        position = np.array([[*wanted, 0.2], [wanted[0] + 0.05, wanted[1], 0.2]])
        position -= [*body.toe_center[0, :2], 0.0]
        R = rotation_world_body(rng.uniform(-0.1, 0.1, (2, 3)))
        xy = ground.project(every, np.broadcast_to(wanted, (ground.count, 2)))
        spots = np.column_stack([xy, ground.compute_height(every, xy)])
        seen = (spots - position[:, None]) @ R
        beyond = (np.abs(seen - body.toe_center[0]) - body.toe_half).max(axis=(0, 2))
        price = 100 * np.maximum(beyond, 0) + np.linalg.norm(xy - wanted, axis=1)
        best = select_region(
            wanted, position, R, body.toe_center[0], body.toe_half, ground.foothold_arrays
        )
        assert best == int(np.argmin(price))


def test_the_library_is_that_of_flat_ground() -> None:
    flat, stones = task_on({}), task_on(STONES)
    assert compute_library_key(stones) == compute_library_key(flat)
    assert flatten_task(flat) is flat
    assert flatten_task(stones).ground.is_flat_everywhere
    assert not stones.ground.is_flat_everywhere


def test_the_reference_follows_the_ground() -> None:
    task = task_on(STEPS)
    above = compute_reference_clearance(task)
    assert above == pytest.approx(0.2)
    state = task.start.state.copy()
    ahead = build_horizon_task(task)
    assert follow_terrain(ahead, above).reference.height[0] == pytest.approx(0.2)
    state[0] = 1.0
    there = replace(ahead, start=replace(task.start, state=state))
    np.testing.assert_allclose(follow_terrain(there, above).reference.height, 0.25)


def test_a_ramp_is_walked_up_online() -> None:
    task = task_on(RAMP)
    library = build_library(flatten_task(task), 1, 0, gaits=0)
    loop = simulate_loop(OnlineController(task, library, OnlineSettings()), task, 1.2)
    assert loop.fall_time is None
    assert told(task, loop) == ""
    assert loop.trajectory.state[-1, 0] > 0.45
    assert loop.trajectory.state[-1, 2] > 0.2 + 0.015


def test_a_safe_stance_braces_within_the_cones_of_a_slope() -> None:
    plane = {"name": "plane", "x": [-3, 3], "y": [-3, 3], "slope": [0.3, 0]}
    task = task_on({"friction": 0.4, "regions": [plane]})
    force = solve_balance_forces(task, task.start.state, task.start.toes, np.ones(4, bool))
    across, along, normal = (force @ task.ground.frame[0].T).T
    assert (np.hypot(across, along) <= 0.4 * normal + 1e-6).all()
    assert force[:, 2].sum() == pytest.approx(task.weight, rel=0.05)


def test_toes_come_down_on_footholds_only() -> None:
    ground = task_on(STONES).ground
    rng = np.random.default_rng(1)
    toes = np.column_stack([rng.uniform([0.2, -0.3], [0.6, 0.3], (4, 2)), np.full(4, 0.03)])
    down = project_to_footholds(ground, toes)
    assert (
        ground.compute_distance_outside(ground.nearest(down[:, :2]), down[:, :2])
        <= -ground.edge + 1e-9
    ).all()
    np.testing.assert_allclose(compute_ground_height(ground, down[:, :2]), down[:, 2], atol=1e-12)
    assert compute_ground_height(ground, np.array([0.255, 0.0])) == -np.inf  # the edge of the gap


@pytest.mark.parametrize(
    ("terrain", "more", "message"),
    [
        (STONES, {"loop": {"estimation": "ekf"}}, "nothing measures where the robot is among"),
        (STONES, {"solver": {"method": "online", "formulation": "published"}}, "flat ground only"),
    ],
)
def test_what_online_does_not_know_is_refused(
    terrain: dict[str, Any], more: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValidationError, match=message):
        stated(terrain, **more)
