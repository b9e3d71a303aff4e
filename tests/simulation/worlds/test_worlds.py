"""Worlds are functions of seed and number, drawn of what specs say of uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import compute_interval
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.climb.simulation.report import build_report
from climbplan.climb.simulation.risk import estimation
from climbplan.climb.simulation.risk.estimation import RiskEstimate, ScenarioOutcome, estimate_risk
from climbplan.climb.simulation.study import simulate_plan
from climbplan.climb.simulation.worlds.perturbed_terrain import perturb_terrain
from climbplan.climb.simulation.worlds.uncertainty import build_layout, draw_numbers
from climbplan.climb.simulation.worlds.uncertainty_spec import read_uncertainty
from climbplan.errors import UsageError
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.motors import compute_motor_stiffness
from climbplan.simulation.pictures import open_camera
from climbplan.simulation.request import SimulationRequest
from climbplan.terrain.raw_surface import RawSurface
from climbplan.terrain.surfaces import Region

Planned = Callable[..., ClimbPlan]


def test_what_a_spec_says_is_drawn(planned: Planned) -> None:
    plan = planned("uncertainty.mass={uniform: [0.1, 0.2]}", "uncertainty.backlash_deg=0")
    layout = build_layout(plan, read_uncertainty(plan))
    assert dict(layout.slices).keys() == {"mass", "stiffness", "friction", "surface"}
    worlds = [layout.world(draw_numbers(3, i, layout.size)) for i in range(400)]
    assert all(1.1 <= w.mass <= 1.2 and not w.backlash.any() for w in worlds)
    assert np.std([w.stiffness for w in worlds]) == pytest.approx(0.1, rel=0.05)
    assert np.std([w.surface for w in worlds]) == pytest.approx(0.003, rel=0.1)


def test_a_world_is_a_function_of_seed_and_number(planned: Planned) -> None:
    plan = planned()
    layout = build_layout(plan, read_uncertainty(plan))
    assert layout.world(draw_numbers(1, 5, layout.size)) == layout.world(
        draw_numbers(1, 5, layout.size)
    )
    assert layout.world(draw_numbers(1, 5, layout.size)) != layout.world(
        draw_numbers(2, 5, layout.size)
    )


def test_worlds_change_the_simulated_model(planned: Planned) -> None:
    plan = planned("uncertainty.com_mm=5", "uncertainty.surface_tilt_deg=1")
    layout = build_layout(plan, read_uncertainty(plan))
    conditions = Conditions(world=layout.world(draw_numbers(0, 0, layout.size)))
    world = conditions.world
    assert world is not None
    assert compute_motor_stiffness(plan.robot, conditions) == pytest.approx(
        compute_motor_stiffness(plan.robot, Conditions()) * world.stiffness
    )
    before, after = plan.terrain.surfaces[0], perturb_terrain(plan.terrain, world).surfaces[0]
    assert isinstance(before, Region)
    assert isinstance(after, Region)
    middle = after.vertices.mean(axis=0) - before.vertices.mean(axis=0)
    assert middle @ before.normal == pytest.approx(world.surface[0])
    assert after.friction == pytest.approx(before.friction * world.friction[0])
    turned = np.arccos(before.normal @ after.normal)
    assert turned == pytest.approx(np.linalg.norm(world.tilt[0]), rel=1e-6)
    assert "<inertial" in build_mjcf(plan, conditions)
    assert "play" in build_mjcf(plan, conditions)


def test_worlds_of_a_scan_are_refused_before_anything_is_simulated(
    planned: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = planned()
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    scan = RawSurface(flat, np.array([[0, 1, 2]]), flatness=0.01, toe_radius=0.01)
    monkeypatch.setattr(estimation, "prepare_steps", lambda *given: pytest.fail("it simulates"))
    with pytest.raises(UsageError, match="triangles of a scan are one piece"):
        estimate_risk(
            replace(plan, terrain=replace(plan.terrain, scan=scan)), Conditions(), "statics", 30, 4
        )


def test_intervals_are_exact() -> None:
    assert compute_interval(0, 300) == pytest.approx((0.0, 0.01222), abs=1e-5)
    assert compute_interval(2, 8) == pytest.approx((0.03185, 0.65086), abs=1e-5)
    assert compute_interval(5, 5)[1] == 1.0


def test_judgements_do_not_depend_on_workers(planned: Planned) -> None:
    plan = planned()
    alone = estimate_risk(plan, Conditions(), "statics", 30, 4)
    assert alone.outcomes == estimate_risk(plan, Conditions(), "statics", 30, 4, workers=2).outcomes
    assert estimate_risk(plan, Conditions(), "statics", 7, 4).outcomes == alone.outcomes[:7]


def test_engines_agree_on_what_certainly_stands_and_falls(planned: Planned) -> None:
    keys = ("mass", "joint_stiffness", "friction", "surface_mm", "backlash_deg")
    plan = planned(*(f"uncertainty.{key}=0" for key in keys), "uncertainty.toe_placement_mm=0.01")
    for friction, falls in ((1.0, False), (0.3, True)):
        for engine in ("statics", "mujoco"):
            judged = estimate_risk(plan, Conditions(speed=2.0, friction=friction), engine, 1, 0)
            assert judged.outcomes[0].fallen is falls
            assert bool(judged.outcomes[0].cause) is falls


def test_the_worst_world_falls_first_or_strays_farthest(planned: Planned) -> None:
    judged = estimate_risk(planned(), Conditions(), "statics", 3, 0)
    ends = [(False, 9.0, 0.01), (False, 9.0, 0.04), (False, 9.0, 0.02)]
    assert _with(judged, ends).worst == 1
    ends = [(True, 7.0, 0.2), (False, 9.0, 0.3), (True, 5.0, 0.1)]
    assert _with(judged, ends).worst == 2
    assert _with(judged, ends).stands == "stands in 1 of 3 worlds"


def _with(judged: RiskEstimate, ends: list[tuple[bool, float, float]]) -> RiskEstimate:
    outcomes = tuple(ScenarioOutcome(fell, time, "", -1, -1, far) for fell, time, far in ends)
    return replace(judged, outcomes=outcomes)


def test_worlds_stray_as_far_in_both_engines(planned: Planned) -> None:
    plan = planned()
    far = [
        [o.farthest for o in estimate_risk(plan, Conditions(), engine, 3, 0).outcomes]
        for engine in ("mujoco", "statics")
    ]
    np.testing.assert_allclose(far[0], far[1], rtol=0.5)
    np.testing.assert_array_equal(np.argsort(far[0]), np.argsort(far[1]))


@pytest.mark.slow
def test_the_worst_world_is_replayed_as_a_film(planned: Planned) -> None:
    plan = planned()
    if isinstance(open_camera(plan.trajectory.com), str):
        pytest.skip("no off-screen drawing here")
    asked = SimulationRequest(Conditions(), worlds=2, engine="statics")
    found = simulate_plan(plan, asked)
    assert found.risk is not None
    assert found.worst is not None
    assert found.worst.number == found.risk.worst
    told = build_report(found)
    assert told.worst is not None
    assert told.worst[1][:4] == b"GIF8"
    assert told.report["worst_world"]["world"] == found.risk.worst
    assert told.worlds == "stands in 2 of 2 worlds"
