"""Online: the library, the tick on its own, and the loop with the nonlinear body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walk_tasks import named, walk_task

from climbplan.errors import PlanFileError, UsageError
from climbplan.walking.check.checker import check_loop, format_failures
from climbplan.walking.kernels.body import integrate_rk4
from climbplan.walking.online import controller as controller_module
from climbplan.walking.online.candidate_selection import SAFE_STANCE
from climbplan.walking.online.closed_loop import LoopScenario, Push, has_recovered, simulate_loop
from climbplan.walking.online.controller import OnlineController, OnlineSettings, build_horizon_task
from climbplan.walking.online.gait_solver import GaitSolver, IterationBudget
from climbplan.walking.online.library import (
    SectionLibrary,
    build_library,
    mirror_library,
    read_library,
    write_library,
)
from climbplan.walking.online.run import compute_library_key
from climbplan.walking.online.safe_stance import plan_safe_stance
from climbplan.walking.online.section_ranking import (
    NearestNeighbours,
    StrategyName,
    train_section_ranking,
)
from climbplan.walking.online.state_feedback import StateNoise
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.problem.problem import build_sampled_task
from climbplan.walking.task.task import VELOCITY, Start, WalkTask

TASK = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)


@pytest.fixture(scope="module")
def library() -> SectionLibrary:
    return build_library(TASK, 3, 0, gaits=0)


def situation(task: WalkTask) -> TickInput:
    start = task.start
    return TickInput(start.state, start.toes, start.toes, np.ones(4, bool))


def pushed(time: float, forward: float, aside: float) -> LoopScenario:
    return LoopScenario(pushes=[Push(time, np.array([forward, aside, 0]))])


def test_sections_and_mirror(library: SectionLibrary) -> None:
    assert library.walks == 3
    assert len(library) == 30
    twice = mirror_library(TASK, mirror_library(TASK, library))
    np.testing.assert_allclose(twice.features, library.features, atol=1e-12)
    np.testing.assert_allclose(twice.toes, library.toes)
    one, other = library.features[0], mirror_library(TASK, library).features[0]
    assert one[1] == -other[1]
    assert NearestNeighbours(library).rank(library.features[7], 3)[0] == 7


def test_library_file(library: SectionLibrary, tmp_path: Path) -> None:
    path = tmp_path / "library.h5"
    write_library(library, path, "this")
    again = read_library(path, "this")
    for name, value in vars(library).items():
        np.testing.assert_array_equal(vars(again)[name], value)
    with pytest.raises(UsageError, match="another robot"):
        read_library(path, "that")
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(PlanFileError):
        read_library(path, "this")


def test_key_is_that_of_the_task_not_of_its_start() -> None:
    integrate_rk4 = walk_task(
        (1.0, 0, 0), integrator="mean", min_contacts=2, workspace_over_stance=True
    )
    assert compute_library_key(integrate_rk4) == compute_library_key(TASK)
    slower = walk_task(integrator="mean", min_contacts=2, reference={"velocity": [1, 0, 0]})
    assert compute_library_key(slower) != compute_library_key(TASK)


def test_walks_under_a_push_in_continuous_time(library: SectionLibrary) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    loop = simulate_loop(controller, TASK, 2.0, pushed(0.81, -1.0, 0))
    assert has_recovered(loop, TASK)
    speed = loop.trajectory.state[:, VELOCITY][:, 0]
    assert speed[163:200].min() < 1.2  # the push was felt
    whole = build_sampled_task(TASK, len(speed) - 1)
    assert format_failures(check_loop(whole, loop.trajectory, loop.push_velocity)) == ""
    # A push that the record hides is found.
    assert "dynamics.velocity" in format_failures(
        check_loop(whole, loop.trajectory, 0 * loop.push_velocity)
    )


def test_noise_is_borne(library: SectionLibrary) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    noise = StateNoise(velocity=0.03, angles=0.005, spin=0.03, position=0.002)
    one = simulate_loop(controller, TASK, 1.2, LoopScenario(noise=noise), seed=4)
    assert one.fall_time is None
    other = simulate_loop(OnlineController(TASK, library, OnlineSettings()), TASK, 1.2)
    assert np.abs(one.trajectory.state - other.trajectory.state).max() > 1e-3


def test_an_empty_library_is_told(library: SectionLibrary) -> None:
    empty = library.select_walks(0)
    command = OnlineController(TASK, empty, OnlineSettings()).tick(situation(TASK))
    assert "library is empty" in command.warning
    assert np.isfinite(command.trajectory.force).all()


def broken(kind: str) -> TickInput:
    good = situation(TASK)
    state, toes = good.state.copy(), good.toes.copy()
    if kind == "nan":
        state[4] = np.nan
    elif kind == "speed":
        state[3] = 1e3
    elif kind == "tilt":
        state[7] = 1.5
    elif kind == "height":
        state[2] = -0.1
    elif kind == "toes":
        toes[2] = [30.0, 0.0, 0.0]
    elif kind == "old":
        return replace(good, age=0.5)
    elif kind == "contact":
        return replace(good, undetected_contacts=(0, 1, 2))
    elif kind == "shape":
        state = state[:7]
    return replace(good, state=state, toes=toes)


WORDS = {
    "nan": "not a number",
    "speed": "speed is impossible",
    "tilt": "tilt",
    "height": "height is impossible",
    "toes": "nowhere near",
    "old": "500 ms old",
    "contact": "LF, RF, LH make no contact",
    "shape": "shape",
}


@pytest.mark.parametrize("kind", list(WORDS))
def test_measurements_that_cannot_be(library: SectionLibrary, kind: str) -> None:
    command = OnlineController(TASK, library, OnlineSettings()).tick(broken(kind))
    assert command.source == SAFE_STANCE
    assert command.warning.startswith("safe stance: ")
    assert WORDS[kind] in command.warning
    force = command.trajectory.force[0]
    assert np.isfinite(force).all()
    assert force[:, 2].sum() == pytest.approx(TASK.weight)
    assert command.trajectory.gait.contact.all()


def test_a_leg_without_contact_is_not_stood_on(library: SectionLibrary) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    command = controller.tick(replace(situation(TASK), undetected_contacts=(2,)))
    assert "LH without contact" in command.warning
    assert not command.trajectory.gait.contact[0, 2]
    assert (command.trajectory.force[0, 2] == 0).all()


def test_where_the_plan_before_slows_down_others_are_looked_at(
    library: SectionLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a steady walk it is enough that it goes on, if it does so as fast as is asked for."""
    controller = OnlineController(TASK, library, OnlineSettings())
    simulate_loop(controller, TASK, 0.8)
    last, here = controller._previous_plan, controller._prediction
    assert last is not None
    told = TickInput(here.state, here.start.toes, last.toes[0], last.gait.contact[0])
    tried = {}
    for slack in (
        controller_module._STEADY_TOLERANCE,
        0.0,
    ):  # no plan is as fast as that to the last digit
        monkeypatch.setattr(controller_module, "_STEADY_TOLERANCE", slack)
        controller._previous_plan, controller._prediction, controller._ticks_since_search = (
            last,
            here,
            0,
        )
        command = controller.tick(told)
        assert command.is_feasible
        tried[slack] = command.num_candidates
    assert tried[0.0] > 1 == tried[0.03]


@pytest.mark.parametrize(("name", "first"), [("trot", 2), ("stand", 1)])
def test_a_gait_goes_on_where_its_qps_led(name: str, first: int) -> None:
    """None is solved twice; a first one that is far off has no second before others were tried."""
    state = TASK.start.state.copy()
    state[VELOCITY] = [-0.5, 0.0, 0.0]
    task = replace(build_horizon_task(TASK), start=Start(state, TASK.start.toes))
    trials, gait = GaitSolver(task, 8e-3), named(name, task)
    program, budget = trials.prepare_program(task, gait), IterationBudget(2000)
    progress = trials.initialise_progress(task, program, None)
    early = trials.solve(task, program, progress, 2, budget)
    assert early is not None
    assert not early.is_feasible
    assert budget.num_qps == first
    late = trials.solve(task, program, progress, 4, budget, allow_elastic=True)
    assert late is not None
    assert late.is_feasible
    assert not progress.left_workspace
    whole = IterationBudget(2000)
    again = trials.initialise_progress(task, program, None)
    assert trials.solve(task, program, again, 4, whole, allow_elastic=True) is not None
    assert budget.num_qps == whole.num_qps == progress.num_qps
    np.testing.assert_allclose(again.iterate.state, progress.iterate.state, atol=1e-6)


@pytest.mark.parametrize(("step", "qps"), [(0.08, 1), (0.12, 2)])
def test_longer_intervals_may_miss_by_more_at_first(step: float, qps: int) -> None:
    """First QPs of heavy robots, whose intervals are long, are far off and mended by a second."""
    state = TASK.start.state.copy()
    state[VELOCITY] = [-0.5, 0.0, 0.0]
    task = replace(build_horizon_task(TASK), dt=step, start=Start(state, TASK.start.toes))
    trials, budget = GaitSolver(task, 8e-3), IterationBudget(2000)
    program = trials.prepare_program(task, named("stand", task))
    found = trials.solve(task, program, trials.initialise_progress(task, program, None), 2, budget)
    assert found is not None
    assert budget.num_qps == qps


@pytest.mark.parametrize("effort", [0, 200, 1400])
def test_effort_bounds_the_qps_of_a_tick(library: SectionLibrary, effort: int) -> None:
    """From a state that no gait can answer, every candidate is tried until the effort is spent."""
    settings = OnlineSettings(max_qp_iterations=effort)
    controller = OnlineController(TASK, library, settings)
    start = situation(TASK)
    state = start.state.copy()
    state[VELOCITY] = [-4.0, 3.0, -1.0]
    command = controller.tick(replace(start, state=state))
    assert command.num_qps <= effort // 60
    assert np.isfinite(command.trajectory.force).all()
    assert command.warning


def test_a_push_that_nobody_survives_is_a_fall(library: SectionLibrary) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    loop = simulate_loop(controller, TASK, 2.0, pushed(0.5, 0, -6.0))
    assert loop.fall_time is not None
    assert not has_recovered(loop, TASK)
    whole = build_sampled_task(TASK, len(loop.trajectory.state) - 1)
    told = format_failures(check_loop(whole, loop.trajectory, loop.push_velocity))
    assert "loop.upright" in told or "loop.height" in told


@pytest.mark.parametrize("name", ["forest", "boosting", "network"])
def test_trained_strategies_rank_gaits(library: SectionLibrary, name: StrategyName) -> None:
    """The gait of a stored situation comes first, or near; no gait comes twice."""
    ranking = train_section_ranking(name, library, 0)
    found = 0
    for k in range(len(library)):
        ranked = ranking.rank(library.features[k], 5)
        gaits = [library.contact[index].tobytes() for index in ranked]
        assert len(set(gaits)) == len(gaits)
        found += library.contact[k].tobytes() in gaits
    assert found > 0.8 * len(library)
    again = train_section_ranking(name, library, 0).rank(library.features[0], 5)
    np.testing.assert_array_equal(again, ranking.rank(library.features[0], 5))


def test_without_sections_every_strategy_ranks_nothing(library: SectionLibrary) -> None:
    empty = library.select_walks(0)
    for name in ("knn", "forest"):
        assert len(train_section_ranking(name, empty, 0).rank(library.features[0], 5)) == 0


@pytest.mark.parametrize("velocity", [(-1.0, 0, 0), (1.8, 0.5, 0), (0, 0, 0)])
def test_the_safe_stance_keeps_the_body_upright(velocity: tuple[float, float, float]) -> None:
    """It brakes without turning over, where equal forces would, and keeps to the cones."""
    start = TASK.start
    state = start.state.copy()
    state[VELOCITY], state[10] = velocity, -1.4  # pitching back
    task = replace(build_horizon_task(TASK), start=Start(state, start.toes))
    stance = plan_safe_stance(task)
    force = stance.force[0]
    body = task.body
    after = integrate_rk4(body.parameters, 0.08, 16, state, start.toes, force)
    assert abs(after[10]) < 0.6
    assert np.hypot(*after[3:5]) < 0.8 * np.hypot(*velocity[:2]) + 0.05
    sideways = np.linalg.norm(force[:, :2], axis=1)
    assert (sideways <= task.ground.friction * force[:, 2] + 1e-9).all()
    assert np.abs(force).max() <= body.force_limit + 1e-9


def test_the_safe_stance_leaves_legs_that_are_out_of_reach() -> None:
    start = TASK.start
    toes = start.toes.copy()
    toes[1, 0] += 0.3
    stance = plan_safe_stance(replace(build_horizon_task(TASK), start=Start(start.state, toes)))
    assert stance.gait.contact[0].tolist() == [True, False, True, True]
    assert (stance.force[0, 1] == 0).all()
    assert stance.toes[1, 1, 0] < toes[1, 0] - 0.2  # it comes down in reach
