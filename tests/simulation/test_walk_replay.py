"""Walks in physics: a plan that holds in continuous time holds here, one that does not falls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import NOMINAL, Conditions, FrictionLoss
from climbplan.simulation.request import SimulationRequest
from climbplan.walking.check.reference_dynamics import integrate_continuously
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.simulation.comparison import compare_walk
from climbplan.walking.simulation.replay import compute_euler_angles, simulate_walk
from climbplan.walking.simulation.rigid_body_study import build_report, simulate_walk_plan
from climbplan.walking.simulation.walk_reference import build_walk_reference

FORWARD = Path(__file__).parents[2] / "specs" / "mpc_forward.yaml"


@pytest.fixture(scope="module")
def mean() -> WalkPlan:
    """A walk whose knots agree with continuous time, with some friction to spare."""
    pytest.importorskip("mujoco")
    overrides = (
        "task.integrator=mean", "task.min_contacts=2", "terrain.friction=0.8",
        "task.reference.velocity=[0.8,0,0]", "solver.time_limit=30", "solver.gaits=60",
    )  # fmt: skip
    return plan_walk(load_mpc(FORWARD, overrides))


@pytest.fixture(scope="module")
def euler() -> WalkPlan:
    """The published form."""
    published = ("task.integrator=euler", "task.workspace_over_stance=false")
    return plan_walk(load_mpc(FORWARD, ("solver.time_limit=60", "solver.gaits=60", *published)))


def test_continuous_plan_holds(mean: WalkPlan) -> None:
    run = simulate_walk(mean, NOMINAL)
    found = compare_walk(mean, run)
    assert not run.fallen
    assert run.samples == mean.task.knots + 1
    assert found.position_error.max() < 0.02
    assert np.median(found.correction) < 0.1
    # Newton: what the ground gives is what the body's velocity shows.
    gained = np.diff(run.velocity, axis=0) * mean.task.body.mass / mean.task.dt
    pushed = run.force[:-1].sum(axis=1) - [0, 0, mean.task.weight]
    np.testing.assert_allclose(gained, pushed, atol=0.2 * mean.task.weight)


def test_body_without_corrections_follows_the_rigid_body_of_the_planner(mean: WalkPlan) -> None:
    run = simulate_walk(mean, Conditions(friction=3.0), feedback=False)
    found, knots = mean.trajectory, 3
    exact = integrate_continuously(
        mean.task.body, mean.task.dt, found.state[0], found.toes[:knots], found.force[:knots]
    )
    np.testing.assert_allclose(run.com[: knots + 1], exact[:, :3], atol=2e-3)
    turned = np.array([compute_euler_angles(r) for r in run.rotation[: knots + 1]])
    np.testing.assert_allclose(turned, exact[:, 6:9], atol=0.1)
    np.testing.assert_allclose(rotation_world_body(turned), run.rotation[: knots + 1], atol=1e-9)


def test_the_shipped_walk_stands_where_the_published_form_falls(euler: WalkPlan) -> None:
    shipped = plan_walk(load_mpc(FORWARD, ("solver.time_limit=60", "solver.gaits=60")))
    assert not simulate_walk(shipped, NOMINAL, feedback=False).fallen
    assert simulate_walk(euler, NOMINAL, feedback=False).fallen


def test_euler_plan_needs_more_correction(mean: WalkPlan, euler: WalkPlan) -> None:
    good, bad = (compare_walk(plan, simulate_walk(plan, NOMINAL)) for plan in (mean, euler))
    assert bad.position_error.max() > 2 * good.position_error.max()
    assert np.median(bad.correction) > 2 * np.median(good.correction)


def test_ice_and_lost_contacts_slip(mean: WalkPlan) -> None:
    ice = simulate_walk(mean, Conditions(friction=0.1))
    assert compare_walk(mean, ice).slips or ice.fallen
    legs = tuple(FrictionLoss(leg, 0.0, 1.0) for leg in range(4))
    lost = compare_walk(mean, simulate_walk(mean, Conditions(losses=legs)))
    assert lost.slips
    assert lost.friction.max() < 0.05


def test_swings_go_from_where_legs_stood_to_where_they_stand(euler: WalkPlan) -> None:
    reference, found = build_walk_reference(euler), euler.trajectory
    for leg, swings in enumerate(reference.swings):
        for swing in swings:
            first = int(np.argmin(np.abs(reference.time - swing.start)))
            last = int(np.argmin(np.abs(reference.time - swing.end)))
            assert not found.gait.contact[first, leg]
            np.testing.assert_allclose(swing.compute_position(swing.start), swing.lift_off)
            np.testing.assert_allclose(
                swing.compute_position(swing.end), swing.touchdown, atol=1e-9
            )
            middle = (swing.start + swing.end) / 2
            assert swing.compute_position(middle)[2] >= euler.task.swing_clearance * 0.99
            if last < euler.task.knots:
                np.testing.assert_allclose(swing.touchdown, found.toes[last, leg])


def test_same_seed_same_runs_and_what_is_told(mean: WalkPlan) -> None:
    asked = SimulationRequest(Conditions(), runs=2, seed=3, pictures=False)
    first, again = simulate_walk_plan(mean, asked), simulate_walk_plan(mean, replace(asked, jobs=2))
    assert first.trials == again.trials
    told = build_report(first)
    assert told.report["runs"] == build_report(again).report["runs"]
    assert told.report["without_feedback"]["path"]["most"] > 0
    assert set(told.figures) == {"path", "forces"}
    assert told.table.count("\n") == 1 + int(first.comparison.loaded.sum())


def test_what_a_body_without_joints_does_not_have(mean: WalkPlan) -> None:
    for asked in (
        SimulationRequest(Conditions(gain=1.1)),
        SimulationRequest(Conditions(backlash=0.01)),
        SimulationRequest(Conditions(), sweep_key="force.safety_friction", sweep_values=(1.0,)),
    ):
        with pytest.raises(UsageError):
            simulate_walk_plan(mean, asked)
