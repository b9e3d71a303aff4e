"""A robot of six legs walks: planned, checked, written and read, and what its legs have to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from climbplan.errors import SpecError
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.robots.leg_pairs import order_in_pairs
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.check.reference_dynamics import euler_rates
from climbplan.walking.check.speed import compute_leg_speeds
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.swing_trajectory import quartic_arch, quintic_progress
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk, solve_task
from climbplan.walking.schema.loading import load_body, load_mpc
from climbplan.walking.task.task import ANGLES, POSITION, SPIN, VELOCITY

SPEC = Path(__file__).parents[2] / "specs" / "mpc_hexapod.yaml"

BODY = """
kind: rigid-body
name: six
mass: 10
inertia: [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]
force_limit: 60
toe_half: [0.06, 0.06, 0.05]
legs:
  LF: [0.3, 0.3, -0.2]
  RF: [0.3, -0.3, -0.2]
  LM: [0, 0.4, -0.2]
  RM: [0, -0.4, -0.2]
  LH: [-0.3, 0.3, -0.2]
  RH: [-0.3, -0.3, -0.2]
"""


@pytest.fixture(scope="module")
def plan() -> WalkPlan:
    pytest.importorskip("pinocchio")
    return plan_walk(load_mpc(SPEC, ["task.knots=5"]))


def test_it_walks_on_tripods_within_its_torques(plan: WalkPlan) -> None:
    task, found = plan.task, plan.trajectory
    assert task.body.leg_names == ("LF", "RF", "LM", "RM", "LR", "RR")
    assert format_failures(check_trajectory(task, found)) == ""
    names = {check.name for check in check_trajectory(task, found)}
    assert {"torque.limit", "stance.reach", "speed.limit"} <= names
    few = found.gait.contact[:-1][found.gait.contact[:-1].sum(axis=1) == 3]
    halves = {tuple(row) for row in few.astype(int).tolist()}
    assert halves <= {(1, 0, 0, 1, 1, 0), (0, 1, 1, 0, 0, 1)}
    assert halves
    broken = found.force.copy()
    broken[0, int(np.flatnonzero(found.gait.contact[0])[0])] *= 1.5
    assert format_failures(
        check_trajectory(task, type(found)(found.state, found.toes, broken, found.gait))
    )


def test_its_file_is_read_as_it_was_written(plan: WalkPlan, tmp_path: Path) -> None:
    write_walk_plan(plan, tmp_path / "plan.h5")
    again = read_walk_plan(tmp_path / "plan.h5")
    assert again.task.body.leg_names == plan.task.body.leg_names
    assert again.task.legs is not None
    assert plan.task.legs is not None
    assert again.task.legs.chain.names == plan.task.legs.chain.names
    np.testing.assert_array_equal(again.trajectory.force, plan.trajectory.force)
    np.testing.assert_array_equal(again.trajectory.gait.contact, plan.trajectory.gait.contact)


def written(folder: Path, text: str) -> str:
    (folder / "body.yaml").write_text(text, encoding="utf-8")
    return str(folder / "body.yaml")


def test_bodies_by_file_have_six_legs_too(tmp_path: Path) -> None:
    assert len(load_body(written(tmp_path, BODY)).legs) == 6


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (BODY.replace("  RH: [-0.3, -0.3, -0.2]\n", ""), "four, six or eight legs, got 5"),
        (BODY.replace("RF: [0.3, -0.3", "RF: [0.3, 0.2"), "expected pairs"),
        (BODY.replace("RM: [0, -0.4", "RM: [0.3, -0.4"), "one pair behind the other"),
        (
            BODY.replace("LF: [0.3, 0.3", "XX: [0.3, -0.3").replace(
                "RF: [0.3, -0.3", "YY: [0.3, 0.3"
            ),
            "expected the order YY, XX, LM",
        ),
    ],
)
def test_legs_are_in_pairs(tmp_path: Path, changed: str, words: str) -> None:
    with pytest.raises(SpecError, match=words):
        load_body(written(tmp_path, changed))


def test_pairs_by_place() -> None:
    places = [[0.0, -1.0], [1.0, 1.0], [1.1, -1.0], [0.0, 1.0]]
    assert order_in_pairs(places) == [1, 2, 3, 0]
    assert order_in_pairs([*places[:3], [2.0, -1.0]]) is None


def test_its_joints_turn_no_faster_than_they_can(plan: WalkPlan) -> None:
    task, found = plan.task, plan.trajectory
    assert task.legs is not None
    check = next(c for c in check_trajectory(task, found) if c.name == "speed.limit")
    assert check.passed
    speed = compute_leg_speeds(task.legs, task, found).speed
    assert speed.max() < task.legs.max_speed.max()
    # Half as fast: what was planned is refused, and planned anew it is kept
    slow = replace(task, legs=replace(task.legs, max_speed=0.5 * task.legs.max_speed))
    assert "speed.limit" in format_failures(check_trajectory(slow, found))
    spec = load_mpc(SPEC).spec
    again = solve_task(slow, spec.solver).trajectory
    assert again is not None
    assert format_failures(check_trajectory(slow, again)) == ""
    used = compute_leg_speeds(task.legs, slow, again).speed / slow.legs.max_speed
    assert used.max() > 0.7  # for it walks on, if slower


def test_speeds_are_those_of_finely_sampled_angles(plan: WalkPlan) -> None:
    """A toe that swings by the stated way, a body that goes straight on: by differences alone."""
    task, found = plan.task, plan.trajectory
    assert task.legs is not None
    n, leg = map(int, np.argwhere(~found.gait.contact[1:-1])[0] + [1, 0])
    assert found.gait.contact[n + 1, leg]
    left, lands = found.toes[n - 1, leg], found.toes[n + 1, leg]
    s = np.linspace(0.0, 1.0, 401)
    way = left + quintic_progress(s)[0][:, None] * (lands - left)
    way[:, 2] += quartic_arch(s)[0] * task.swing_clearance
    drive = found.state[[n, n + 1]]
    time = task.dt * s
    path = CubicHermiteSpline([0.0, task.dt], drive[:, POSITION], drive[:, VELOCITY])(time)
    rates = euler_rates(drive[:, ANGLES], drive[:, SPIN])
    turned = CubicHermiteSpline([0.0, task.dt], drive[:, ANGLES], rates)(time)
    spots = np.einsum("ti,tij->tj", way - path, rotation_world_body(turned))
    one = task.legs.chain.only(slice(leg, leg + 1))
    bounds = task.legs.lower[leg : leg + 1], task.legs.upper[leg : leg + 1]
    angles = one.inverse(spots[:, None], *bounds).angles[:, 0, 0]
    speed = np.abs(np.gradient(angles, time, axis=0)).max(axis=0)
    told = compute_leg_speeds(task.legs, task, found).speed[n, leg]
    np.testing.assert_allclose(told, speed, rtol=0.05, atol=0.02)
    assert told.max() > 0.5
