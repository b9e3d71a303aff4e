"""What planning finds depends on its budget of work and its seed, never on the clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded, scene

from climbplan.errors import LimitReached
from climbplan.limms.arms.carrying import plan_carrying
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.consensus.mixed_integer import MixedIntegerBlock
from climbplan.limms.consensus.problem import build_problem
from climbplan.limms.motion.assembly import build_initial_plan
from climbplan.limms.motion.plan_making import PlanRecord, make_plan
from climbplan.limms.plan.file import read_limms_plan, write_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner import planner
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.limms.task_planning.single_actions import find_single_actions
from climbplan.progress import Progress


def _racing(clock: Callable[[], float], factor: float) -> Callable[[], float]:
    """A clock that runs `factor` times as fast, as on a machine that much slower."""
    begin = clock()
    return lambda: begin + factor * (clock() - begin)


@pytest.mark.parametrize("method", ["mode-search", "admm"])
def test_a_slow_machine_finds_the_same_plan(
    method: str, throw: LimmsPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = loaded("limms_throw", f"solver.method={method}", "solver.time_limit=1e6")
    quiet = throw if method == "mode-search" else plan_limms(spec)
    for name in ("monotonic", "perf_counter", "process_time"):
        monkeypatch.setattr(time, name, _racing(getattr(time, name), 2000.0))
    slow = plan_limms(spec)
    assert slow.timings["total"] > 100 > quiet.timings["total"]
    assert slow.status == quiet.status == "feasible"
    assert slow.sizes == quiet.sizes
    for name in ("time", "box_position", "joint_angles", "force"):
        assert np.array_equal(getattr(slow.motion, name), getattr(quiet.motion, name))


def test_the_budget_of_programs_ends_the_search() -> None:
    with pytest.raises(
        LimitReached, match=r"with 1 nonlinear programs.*`solver\.max_nlp_solves` ended throw"
    ):
        plan_limms(loaded("limms_throw", "solver.max_nlp_solves=1"))


def test_parts_take_from_the_whole() -> None:
    whole = SearchBudget(60.0, 10)
    whole.begin("one")
    part = whole.split(3)
    assert part.deadline == whole.deadline
    for number in range(3):
        part.begin(f"choice {number}")
    with pytest.raises(LimitReached, match="with 3 nonlinear programs"):
        part.require_remaining()
    whole.merge(part)
    assert whole.remaining == 6
    assert whole.split(100).max_programs == 6


def test_a_plan_that_the_clock_cut_short_says_so(tmp_path: Path) -> None:
    spec = loaded("limms_throw")
    own = scene("limms_throw")
    (action,) = find_single_actions(own).actions
    budget = SearchBudget(60.0, 100)
    world = plan_carrying(build_initial_plan(own), action, budget, np.random.default_rng(0))
    assert world is not None
    making = PlanRecord("mode-search", action.describe(own), {"total": 0.0}, {}, {})
    whole = make_plan(spec, own, world, budget, making)
    budget.deadline = time.monotonic()
    cut = make_plan(spec, own, world, budget, making)
    assert (whole.status, cut.status) == ("feasible", "limit")
    write_limms_plan(cut, tmp_path / "plan.h5")
    assert read_limms_plan(tmp_path / "plan.h5").status == "limit"
    assert "`solver.time_limit` (60 s) ended the search" in cut.warnings[0]
    assert cut.warnings[1:] == whole.warnings


@pytest.mark.slow
def test_first_integers_are_those_of_the_work_they_got() -> None:
    setting = build_problem(scene("limms_lift_light"), 8)
    found = []
    for _ in range(2):
        block = MixedIntegerBlock(setting)
        block.fix_behaviour("arms")
        found.append(block.solve(20))
    assert found[0].status == found[1].status == "limit"
    assert found[0].x is None or found[1].x is not None
    if found[0].x is not None and found[1].x is not None:
        assert np.array_equal(found[0].x, found[1].x)


@pytest.mark.parametrize("has_legs", [True, False])
def test_a_pace_that_finds_nothing_leaves_budget_to_calmer_ones_with_legs(
    has_legs: bool, throw: LimmsPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    budgets: dict[float, int] = {}

    def at_pace(
        loaded: LoadedLimms, scene: ModuleScene, report: Progress, budget: SearchBudget
    ) -> tuple[LimmsPlan, bool]:
        budgets[scene.pace] = budget.remaining
        if scene.pace > 0.25:
            budget.num_sequences += budget.remaining
            budget.require_remaining()
        return throw, scene.pace < 0.2

    monkeypatch.setattr(planner, "_plan_at_pace", at_pace)
    allowed = "[arms, quadruped]" if has_legs else "[arms]"
    spec = loaded("limms_walk", "massless=false", "robot=limms_carrier", f"task.allow={allowed}")
    if not has_legs:
        with pytest.raises(LimitReached, match="with 200 nonlinear programs"):
            plan_limms(spec)
        assert budgets == {1.0: 200}
        return
    assert plan_limms(spec) is throw
    assert budgets == {1.0: 100, 0.5: 50, 0.25: 25, 0.12: 50}


def test_arms_are_not_solved_again_at_another_pace() -> None:
    own = scene("limms_throw")
    (action,) = find_single_actions(own).actions
    budget = SearchBudget(60.0, 100)
    worlds = []
    for pace in (1.0, 0.5):
        start = build_initial_plan(replace(own, pace=pace))
        worlds.append(plan_carrying(start, action, budget, np.random.default_rng(0)))
        programs = budget.work.programs
    first, calmer = worlds
    assert first is not None
    assert calmer is not None
    assert programs == 1
    assert calmer.stretches[-1].time[-1] == first.stretches[-1].time[-1]
    ways = [sum(each.time[-1] for each in world.stretches) for world in (first, calmer)]
    assert ways[1] > ways[0]
