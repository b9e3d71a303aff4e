"""Plans judged in a sample of worlds: what is stored, what the badge says, and counting again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from short_climb import SHORT_CLIMB

from climbplan.api.making import run_planner
from climbplan.api.recounting import recount_worlds, require_climb
from climbplan.climb.check.verification import verify, verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.plan.world_sample import WorldSample, compute_wilson_interval
from climbplan.climb.schema.loading import load_text
from climbplan.climb.simulation.risk import sampling, suggestions
from climbplan.climb.simulation.risk.estimation import RiskEstimate, ScenarioOutcome
from climbplan.climb.simulation.worlds.uncertainty import Uncertainty, build_layout
from climbplan.climb.simulation.worlds.uncertainty_spec import read_uncertainty
from climbplan.errors import PlanFileError, UsageError

Planned = Callable[..., ClimbPlan]


def sample(falls: int, worlds: int = 100) -> WorldSample:
    lower, upper = compute_wilson_interval(worlds - falls, worlds)
    spread = {"friction": ["normal", 0.0, 0.2]}
    return WorldSample("statics", 3, worlds, falls, lower, upper, spread, ("7: a toe slides, LR",))


def judged(plan: ClimbPlan, falls: int, worlds: int) -> RiskEstimate:
    layout = build_layout(plan, read_uncertainty(plan))
    ends = [ScenarioOutcome(k < falls, 1.0, "", 0, 0, 0.0) for k in range(worlds)]
    return RiskEstimate("statics", 3, layout, tuple(ends))


def test_wilson_intervals() -> None:
    assert compute_wilson_interval(95, 100) == pytest.approx((0.8882, 0.9785), abs=1e-4)
    assert compute_wilson_interval(100, 100) == pytest.approx((0.9630, 1.0), abs=1e-4)
    assert compute_wilson_interval(0, 100) == pytest.approx((0.0, 0.0370), abs=1e-4)


def test_falls_in_more_than_one_world_of_twenty_make_a_plan_fragile(planned: Planned) -> None:
    plan = planned()
    good = verify_plan(replace(plan, sample=sample(5)))
    assert good.risk_summary == "stands in 95 of 100 worlds"
    assert good.fragile == verify_plan(plan).fragile
    assert {c.name for c in good.checks if c.judged} >= {"robust.worlds"}
    bad = verify_plan(replace(plan, sample=sample(37)))
    assert bad.passed
    assert bad.level == "look"
    (words,) = set(bad.fragile) - set(good.fragile)
    assert words.startswith("stands in 63 of 100 worlds of its uncertainty (statics, seed 3)")
    assert "95 % interval 53 to 72 %, at least 95% required; most frequent: 7: a toe" in words


def test_an_interval_that_is_not_that_of_the_counts_fails(planned: Planned) -> None:
    told = replace(sample(37), lower=0.95)
    found = verify_plan(replace(planned(), sample=told))
    assert [check.name for check in found.failed] == ["robust.worlds"]


def test_a_sample_is_stored_and_read(planned: Planned, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    kept = replace(planned(), sample=sample(2))
    write_climb(kept, path)
    assert read_climb(path).sample == kept.sample
    with h5py.File(path, "r+") as file:
        file.attrs["worlds"] = json.dumps({**sample(2).as_dict(), "falls": 101})
    with pytest.raises(PlanFileError, match="attribute worlds is damaged"):
        read_climb(path)


def test_worlds_are_judged_where_an_uncertainty_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> RiskEstimate:
        raise AssertionError("no worlds are judged")

    monkeypatch.setattr(sampling, "estimate_risk", refuse)
    assert run_planner(load_text(SHORT_CLIMB, "short", [])).summary
    seen: list[tuple[object, ...]] = []

    def count(plan: ClimbPlan, *args: object, **_: object) -> RiskEstimate:
        seen.append(args[1:4])
        return judged(plan, 80, 200)

    monkeypatch.setattr(sampling, "estimate_risk", count)
    made = run_planner(load_text(SHORT_CLIMB, "short", ["uncertainty.friction=0.2", "seed=4"]))
    assert seen == [("statics", sampling.NUM_WORLDS, 4)]
    assert made.summary[-1].split()[:2] == ["worlds", "TOO"]
    assert "stands in 120 of 200 worlds (statics), 95 % interval 53 to 67 %" in made.summary[-1]


def test_a_robot_that_the_engine_does_not_know_is_warned_of(
    planned: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **kwargs: object) -> RiskEstimate:
        raise UsageError("grippers, which the statics engine does not know")

    monkeypatch.setattr(sampling, "estimate_risk", refuse)
    plan = sampling.add_world_sample(planned(), 0)
    assert plan.sample is None
    assert plan.warnings[-1].startswith("the worlds of `uncertainty` are not judged: grippers")


def test_falls_are_counted_again_by_the_stored_seed(planned: Planned, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    plan = planned()
    write_climb(plan, path)
    bare = verify(path)
    with pytest.raises(UsageError, match="names no worlds"):
        recount_worlds(path, bare)
    told = sampling.sample_worlds(plan, 11, worlds=8)
    assert told.worlds == 8
    assert set(told.uncertainty) == {"mass", "stiffness", "friction", "surface", "backlash"}
    write_climb(replace(plan, sample=told), path)
    found = recount_worlds(path, verify(path))
    assert found.checks[-1].name == "robust.recount"
    assert found.checks[-1].residual == 0
    low, high = compute_wilson_interval(told.worlds - told.falls - 1, told.worlds)
    wrong = replace(told, falls=told.falls + 1, lower=low, upper=high)
    write_climb(replace(plan, sample=wrong), path)
    assert [c.name for c in recount_worlds(path, verify(path)).failed] == ["robust.recount"]
    require_climb(path)
    with h5py.File(path, "r+") as file:
        file.attrs["format"] = "climbplan/mpc"
    with pytest.raises(UsageError, match="names no worlds"):
        require_climb(path)


def test_what_is_needed_was_played(planned: Planned, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = planned()

    def count(
        plan: ClimbPlan, *args: object, uncertainty: Uncertainty | None = None, **_: object
    ) -> RiskEstimate:
        few = uncertainty is not None and uncertainty.friction.high == 0.1
        return judged(plan, 2 if few else 30, 100)

    monkeypatch.setattr(suggestions, "estimate_risk", count)
    words = suggestions.suggest_knowledge(plan, 0, 100)
    assert "uncertainty.friction=0.1" in words
    assert words.endswith("(stands in 98 of 100 worlds then)")
    monkeypatch.setattr(suggestions, "estimate_risk", lambda plan, *a, **k: judged(plan, 30, 100))
    assert suggestions.suggest_knowledge(plan, 0, 100).startswith(
        "more than knowing all that is uncertain"
    )
