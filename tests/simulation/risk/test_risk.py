"""`risk:`: plans judged in uncertain worlds, planned again where they fell, and what files tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.climb.check.verification import verification_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.plan.promise import Promise, interval_of
from climbplan.climb.planner import plan_climb
from climbplan.errors import PlanFileError, SpecError
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.risk import planning
from climbplan.simulation.risk.planning import Ways, plan_with_risk
from climbplan.simulation.worlds.judging import judge_plan
from climbplan.spec.loading import LoadedClimb, load_text

SPEC = """
kind: climb
robot: silvia
terrain:
  friction: 1.0
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}
task:
  rounds: 1
  start: {com: [0, 0, 0]}
  goal: {com: [0, 0, 0.05]}
"""
WAYS = Ways(1, lambda stage, part: None)
SLIPPERY = ["risk=0.05", "margins.friction=0", "margins.pressure=0", "margins.slip=0"]
SURE = ["risk=0.2", "uncertainty.surface_mm=0", "uncertainty.friction=0.01"]


def made(overrides: list[str]) -> tuple[ClimbPlan, int]:
    """A plan with its promise, and how often it was planned."""
    times = 0

    def plan(given: LoadedClimb) -> ClimbPlan:
        nonlocal times
        times += 1
        return plan_climb(given)

    loaded = load_text(SPEC, "short", overrides)
    return plan_with_risk(loaded, plan, LoadedClimb.with_overrides, WAYS), times


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "LOOKED", 40)
    monkeypatch.setattr(planning, "FEWEST", 60)
    monkeypatch.setattr(planning, "TIMES", 2)


def test_a_plan_that_stands_is_planned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    plan, times = made(SURE)
    promise = plan.promise
    assert promise is not None
    assert times == 1
    assert promise.met
    assert promise.helps == ()
    assert promise.worlds == 60
    assert promise.upper == pytest.approx(interval_of(promise.falls, 60)[1])
    assert f"stands in {60 - promise.falls} of 60 worlds" in plan.summary[-1]
    # The same worlds again, by seed and number alone
    again = judge_plan(plan, Conditions(), "statics", 60, promise.seed)
    assert again.falls == promise.falls
    assert verification_of(plan).fragile == ()


def test_where_it_fell_it_is_planned_with_more_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few(monkeypatch)
    worse = [*SLIPPERY, "margins.friction=0.005", "uncertainty.friction=0.4"]
    plan, times = made(worse)
    promise = plan.promise
    assert promise is not None
    assert times > 1
    assert len(promise.tried) == times
    assert "round 1 x" in promise.tried[1]
    assert not promise.met
    assert promise.fells
    assert any("uncertainty." in words for words in promise.helps)
    same, _ = made(worse)
    assert same.promise == promise
    np.testing.assert_array_equal(same.forces.force, plan.forces.force)
    verification = verification_of(plan)
    assert verification.passed
    assert any("asked at most 5.00%" in words for words in verification.fragile)


def test_files_keep_the_promise_and_verify_recomputes_its_interval(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    few(monkeypatch)
    plan, _ = made(SURE)
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    read = read_climb(path)
    assert read.promise == plan.promise
    assert verification_of(read).stands == plan.promise.words  # type: ignore[union-attr]
    for changed in ({"upper": 0.001}, {"falls": plan.promise.falls + 9}, {"risk": 0.5}):  # type: ignore[union-attr]
        lied = replace(read, promise=replace(read.promise, **changed))  # type: ignore[arg-type,type-var]
        failed = [check.name for check in verification_of(lied).failed]
        assert failed == ["robust.risk"]
    silent = replace(read, promise=None)
    assert any("none were played" in words for words in verification_of(silent).fragile)
    with h5py.File(path, "r+") as file:
        file.attrs["risk"] = file.attrs["risk"].replace('"falls": ', '"falls": -1')
    with pytest.raises(PlanFileError, match="no promise"):
        read_climb(path)


def test_risk_is_a_probability() -> None:
    assert load_text(SPEC, "short", []).spec.risk is None
    for wrong in ("0", "1", "-0.1", "often"):
        with pytest.raises(SpecError, match="risk"):
            load_text(SPEC, "short", [f"risk={wrong}"])


def test_interval_is_clopper_and_pearsons() -> None:
    assert interval_of(0, 300) == pytest.approx((0.0, 0.012221), abs=1e-6)
    assert interval_of(300, 300)[1] == 1.0
    met = Promise(0.02, "statics", 0, 300, 0, *interval_of(0, 300), {}, (), (), ())
    assert met.met
    assert not replace(met, risk=0.01).met
