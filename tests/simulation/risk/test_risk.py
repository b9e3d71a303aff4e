"""`risk:`: plans judged in uncertain worlds, planned again where they fell, and what files tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.api.recounting import recount_worlds
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.plan.promise import Promise, compute_interval
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import LoadedClimb, load_text
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.simulation.risk import estimation, planning
from climbplan.climb.simulation.risk.estimation import RiskEstimate, ScenarioOutcome, estimate_risk
from climbplan.climb.simulation.risk.margin_increase import (
    increase_margins,
    list_gaits,
    read_margins,
)
from climbplan.climb.simulation.risk.planning import Execution, plan_with_risk
from climbplan.climb.simulation.worlds.uncertainty import build_layout, draw_numbers
from climbplan.climb.simulation.worlds.uncertainty_spec import read_uncertainty
from climbplan.errors import PlanFileError, SpecError
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import Engine

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
WAYS = Execution(1, lambda stage, part: None)
SLIPPERY = ["risk=0.05", "margins.friction=0", "margins.normal_force=0", "margins.slip=0"]
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
    monkeypatch.setattr(planning, "NUM_SEARCH_WORLDS", 40)
    monkeypatch.setattr(planning, "MIN_WORLDS", 60)
    monkeypatch.setattr(planning, "MAX_REPLANS", 2)


@pytest.mark.slow
def test_a_plan_that_stands_is_planned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    plan, times = made(SURE)
    promise = plan.promise
    assert promise is not None
    assert times == 1
    assert promise.met
    assert promise.helps == ()
    assert promise.worlds == 60
    assert promise.upper == pytest.approx(compute_interval(promise.falls, 60)[1])
    assert f"stands in {60 - promise.falls} of 60 worlds" in plan.summary[-1]
    # The same worlds again, by seed and number alone
    again = estimate_risk(plan, Conditions(), "statics", 60, promise.seed)
    assert again.falls == promise.falls
    assert verify_plan(plan).fragile == ()


@pytest.mark.slow
def test_where_it_fell_it_is_planned_with_more_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few(monkeypatch)
    worse = [*SLIPPERY, "margins.friction=0.005", "uncertainty.friction=0.4"]
    plan, times = made(worse)
    promise = plan.promise
    assert promise is not None
    assert times > 1
    assert sum("fresh" not in words for words in promise.tried) == times
    assert "round 1 x" in promise.tried[1]
    assert not promise.met
    assert promise.fells
    assert any("uncertainty." in words for words in promise.helps)
    verification = verify_plan(plan)
    assert verification.passed
    assert any("asked at most 5.00%" in words for words in verification.fragile)


@pytest.mark.slow
def test_the_same_seed_promises_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    worse = [*SLIPPERY, "margins.friction=0.005", "uncertainty.friction=0.4"]
    (one, _), (other, _) = made(worse), made(worse)
    assert one.promise == other.promise
    np.testing.assert_array_equal(one.forces.force, other.forces.force)


def test_what_fresh_worlds_fell_is_planned_again_and_judged_in_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few(monkeypatch)
    judged: list[tuple[int, int]] = []

    def judge(
        plan: ClimbPlan, base: Conditions, engine: str, worlds: int, seed: int, **_: object
    ) -> RiskEstimate:
        """Falls in 12 of many worlds, of plans that are not asked for more than stated."""
        judged.append((worlds, seed))
        layout = build_layout(plan, read_uncertainty(plan))
        falls = 12 if worlds > 40 and "margins" not in plan.spec_text else 0
        ends = [ScenarioOutcome(k < falls, 1.0, "", 0, 0, 0.0) for k in range(worlds)]
        return RiskEstimate("statics", seed, layout, tuple(ends))

    monkeypatch.setattr(planning, "estimate_risk", judge)
    plan, times = made(["risk=0.1"])
    promise = plan.promise
    assert promise is not None
    assert times == 2
    assert promise.met
    looked, first, again, last = judged
    assert looked[0] == 40
    assert first[0] == again[0] == last[0] == 100
    assert first[1] == again[1]  # compared in the worlds that it fell in
    assert len({looked[1], first[1], last[1]}) == 3  # and judged in worlds of their own
    assert promise.seed == last[1]
    assert [words.startswith("judged in fresh worlds") for words in promise.tried] == [
        False, True, False, True,
    ]  # fmt: skip


def _count_in_closed_loop(
    monkeypatch: pytest.MonkeyPatch, overrides: list[str], falls: int, stops: int
) -> tuple[ClimbPlan, list[tuple[Conditions, str, int]]]:
    """Return a plan with falls and stops among the first of all worlds, and how it was judged."""
    judged: list[tuple[Conditions, str, int]] = []

    def judge(
        plan: ClimbPlan, base: Conditions, engine: Engine, worlds: int, seed: int, **_: object
    ) -> RiskEstimate:
        judged.append((base, engine, worlds))
        layout = build_layout(plan, read_uncertainty(plan))
        ends = [
            ScenarioOutcome(
                k < falls, 1.0, "", 0, 0, 0.0, "a toe" if falls <= k < falls + stops else ""
            )
            for k in range(worlds)
        ]
        return RiskEstimate(engine, seed, layout, tuple(ends))

    monkeypatch.setattr(planning, "estimate_risk", judge)
    monkeypatch.setattr(planning, "load_mujoco", lambda: None)
    return made(["closed_loop=true", *overrides])[0], judged


def test_falls_are_counted_in_closed_loop_on_request(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plan, judged = _count_in_closed_loop(monkeypatch, ["risk=0.1"], falls=1, stops=2)
    assert all(base.closed_loop and engine == "mujoco" for base, engine, _ in judged)
    looked, validated = (worlds for _, _, worlds in judged)
    assert looked == planning.NUM_CLOSED_LOOP_WORLDS
    # The fewest worlds that show the bound with one fall
    assert compute_interval(1, validated)[1] <= 0.1 < compute_interval(1, validated - 1)[1]
    write_climb(plan, tmp_path / "plan.h5")
    promise = read_climb(tmp_path / "plan.h5").promise
    assert promise is not None
    assert promise.met
    assert promise == plan.promise
    expected = f"stands in {validated - 1} of {validated} worlds in closed loop, stops before its"
    assert promise.words == f"{expected} goal in 2"
    assert verify_plan(plan).fragile == ()
    without = replace(plan, promise=replace(promise, closed_loop=False))
    (failed,) = (check for check in verify_plan(without).checks if not check.passed)
    assert failed.name == "robust.risk"
    assert "counted in open loop where the spec asks for closed loop" in failed.margin
    with h5py.File(tmp_path / "plan.h5", "r+") as file:
        file.attrs["risk"] = str(file.attrs["risk"]).replace('"stops": 2', f'"stops": {validated}')
    with pytest.raises(PlanFileError, match="1 falls and"):
        read_climb(tmp_path / "plan.h5")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["closed_loop=true"], "closed_loop: expected `risk` as well"),
        (
            ["closed_loop=true", "risk=0.1", "trajectory.pace=1"],
            "risk: expected no `trajectory.pace`: closed-loop execution",
        ),
        (["risk=0.1", "trajectory.pace=1"], "risk: expected no `trajectory.pace`: falls are"),
        (["closed_loop=true", "risk=0.003"], "risk: expected at least 0.004"),
        (["closed_loop=true", "risk=0.1", "robot=scaler"], "closed_loop: .* has five-bar legs"),
    ],
)
def test_risk_is_refused_where_falls_cannot_be_counted(overrides: list[str], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        load_text(SPEC, "short", overrides)


@pytest.mark.merge
def test_falls_in_closed_loop_are_those_of_the_worlds_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.setattr(planning, "NUM_CLOSED_LOOP_WORLDS", 2)
    monkeypatch.setattr(planning, "MAX_CLOSED_LOOP_WORLDS", 2)
    plan, _ = made(["closed_loop=true", *SURE])
    promise = plan.promise
    assert promise is not None
    assert (promise.engine, promise.closed_loop, promise.worlds) == ("mujoco", True, 2)
    again = estimate_risk(plan, Conditions(closed_loop=True), "mujoco", 2, promise.seed)
    assert (again.falls, again.stops) == (promise.falls, promise.stops)
    # `verify --worlds` plays them in closed loop, too
    played: list[Conditions] = []
    monkeypatch.setattr(
        estimation, "estimate_risk", lambda plan, base, *_: played.append(base) or again
    )
    write_climb(plan, tmp_path / "plan.h5")
    recounted = recount_worlds(tmp_path / "plan.h5", verify_plan(plan))
    assert played == [Conditions(closed_loop=True)]
    assert recounted.checks[-1].name == "robust.recount"
    assert recounted.checks[-1].passed


def test_more_is_asked_for_by_what_tells_falls_apart() -> None:
    plan = plan_climb(load_text(SPEC, "short", []))
    layout = build_layout(plan, read_uncertainty(plan))
    stated = read_margins(MarginsSpec())

    def fallen(name: str) -> RiskEstimate:
        """Worlds that fall by the first number of a quantity."""
        part = dict(layout.slices)[name]
        numbers = [draw_numbers(0, k, layout.size)[part.start] for k in range(200)]
        ends = [ScenarioOutcome(bool(n < -1), 1.0, "", 0, 0, 0.0) for n in numbers]
        return RiskEstimate("statics", 0, layout, tuple(ends))

    slippery, elsewhere = (
        increase_margins(stated, fallen(n), plan) for n in ("friction", "surface")
    )
    assert slippery.slip > stated.slip
    assert slippery.depth == stated.depth
    assert elsewhere.depth > stated.depth
    assert elsewhere.slip == stated.slip
    assert slippery.rounds[1] > 1
    spec = load_text(SPEC, "short", slippery.overrides).spec
    assert spec.margins.slip == pytest.approx(slippery.slip)
    assert spec.margins.rounds == slippery.rounds


def test_where_margins_do_not_help_limbs_move_in_other_orders(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few(monkeypatch)

    def judge(
        plan: ClimbPlan, base: Conditions, engine: str, worlds: int, seed: int, **_: object
    ) -> RiskEstimate:
        """All stand whose middle limbs move first."""
        falls = 0 if "RM, LM" in plan.spec_text.replace("'", "").split("gait")[-1][:12] else worlds
        ends = [ScenarioOutcome(k < falls, 1.0, "", 0, 0, 0.0) for k in range(worlds)]
        layout = build_layout(plan, read_uncertainty(plan))
        return RiskEstimate("statics", seed, layout, tuple(ends))

    monkeypatch.setattr(planning, "estimate_risk", judge)
    plan, _ = made(["risk=0.1"])
    assert plan.promise is not None
    assert any("gait RM LM RF LR RR LF" in words for words in plan.promise.tried)
    assert plan.promise.falls == 0


def test_orders_put_opposite_limbs_after_one_another() -> None:
    limbs = ("RF", "RM", "RR", "LR", "LM", "LF")
    found = list_gaits(limbs, limbs)
    assert ("RM", "LM", "RF", "LR", "RR", "LF") in found
    assert limbs not in found
    assert len(set(found)) == len(found) == 4
    assert all(sorted(one) == sorted(limbs) for one in found)


@pytest.mark.slow
def test_files_keep_the_promise_and_verify_recomputes_its_interval(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    few(monkeypatch)
    plan, _ = made(SURE)
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    read = read_climb(path)
    assert read.promise == plan.promise
    assert verify_plan(read).risk_summary == plan.promise.words  # type: ignore[union-attr]
    for changed in ({"upper": 0.001}, {"falls": plan.promise.falls + 9}, {"risk": 0.5}):  # type: ignore[union-attr]
        lied = replace(read, promise=replace(read.promise, **changed))  # type: ignore[arg-type,type-var]
        failed = [check.name for check in verify_plan(lied).failed]
        assert failed == ["robust.risk"]
    silent = replace(read, promise=None)
    assert any("none were played" in words for words in verify_plan(silent).fragile)
    with h5py.File(path, "r+") as file:
        file.attrs["risk"] = file.attrs["risk"].replace('"falls": ', '"falls": -1')
    with pytest.raises(PlanFileError, match="attribute risk is damaged"):
        read_climb(path)


def test_risk_is_a_probability() -> None:
    assert load_text(SPEC, "short", []).spec.risk is None
    for wrong in ("0", "1", "-0.1", "often"):
        with pytest.raises(SpecError, match="risk"):
            load_text(SPEC, "short", [f"risk={wrong}"])


def test_interval_is_clopper_and_pearsons() -> None:
    assert compute_interval(0, 300) == pytest.approx((0.0, 0.012221), abs=1e-6)
    assert compute_interval(300, 300)[1] == 1.0
    met = Promise(0.02, "statics", 0, 300, 0, *compute_interval(0, 300), {}, (), (), ())
    assert met.met
    assert not replace(met, risk=0.01).met
