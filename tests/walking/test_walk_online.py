"""Online: the library, the tick on its own, and the loop with the nonlinear body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walk_tasks import named, walk_task

from climbplan.errors import PlanFileError, UsageError
from climbplan.walking.check.checker import check_loop, failures
from climbplan.walking.kernels.body import moved
from climbplan.walking.online import tick
from climbplan.walking.online.attempt import Budget, GaitTrials
from climbplan.walking.online.choice import SAFE
from climbplan.walking.online.closed_loop import LoopWorld, Push, recovered, run_loop
from climbplan.walking.online.library import (
    Library,
    build_library,
    mirrored,
    read_library,
    write_library,
)
from climbplan.walking.online.measurement import Situation
from climbplan.walking.online.perception import Noise
from climbplan.walking.online.run import library_key
from climbplan.walking.online.safe_stance import safe_stance
from climbplan.walking.online.strategies import Neighbours, StrategyName, trained
from climbplan.walking.online.tick import OnlineController, OnlineSettings, horizon_of
from climbplan.walking.problem.problem import sampled_task
from climbplan.walking.task.task import VELOCITY, Start, WalkTask

TASK = walk_task(integrator="mean", least_contacts=2, whole_stance=True)


@pytest.fixture(scope="module")
def library() -> Library:
    return build_library(TASK, 3, 0, gaits=0)


def situation(task: WalkTask) -> Situation:
    start = task.start
    return Situation(start.state, start.toes, start.toes, np.ones(4, bool))


def pushed(time: float, forward: float, aside: float) -> LoopWorld:
    return LoopWorld(pushes=[Push(time, np.array([forward, aside, 0]))])


def test_sections_and_mirror(library: Library) -> None:
    assert library.walks == 3
    assert len(library) == 30
    twice = mirrored(TASK, mirrored(TASK, library))
    np.testing.assert_allclose(twice.features, library.features, atol=1e-12)
    np.testing.assert_allclose(twice.toes, library.toes)
    one, other = library.features[0], mirrored(TASK, library).features[0]
    assert one[1] == -other[1]
    assert Neighbours(library).ranked(library.features[7], 3)[0] == 7


def test_library_file(library: Library, tmp_path: Path) -> None:
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
    moved = walk_task((1.0, 0, 0), integrator="mean", least_contacts=2, whole_stance=True)
    assert library_key(moved) == library_key(TASK)
    slower = walk_task(integrator="mean", least_contacts=2, reference={"velocity": [1, 0, 0]})
    assert library_key(slower) != library_key(TASK)


def test_walks_under_a_push_in_continuous_time(library: Library) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    loop = run_loop(controller, TASK, 2.0, pushed(0.81, -1.0, 0))
    assert recovered(loop, TASK)
    speed = loop.trajectory.state[:, VELOCITY][:, 0]
    assert speed[163:200].min() < 1.2  # the push was felt
    whole = sampled_task(TASK, len(speed) - 1)
    assert failures(check_loop(whole, loop.trajectory, loop.pushed)) == ""
    # A push that the record hides is found.
    assert "dynamics.velocity" in failures(check_loop(whole, loop.trajectory, 0 * loop.pushed))


def test_noise_is_borne(library: Library) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    noise = Noise(velocity=0.03, angles=0.005, spin=0.03, position=0.002)
    one = run_loop(controller, TASK, 1.2, LoopWorld(noise=noise), seed=4)
    assert one.fell is None
    other = run_loop(OnlineController(TASK, library, OnlineSettings()), TASK, 1.2)
    assert np.abs(one.trajectory.state - other.trajectory.state).max() > 1e-3


def test_an_empty_library_is_told(library: Library) -> None:
    empty = library.first(0)
    command = OnlineController(TASK, empty, OnlineSettings()).tick(situation(TASK))
    assert "library is empty" in command.warning
    assert np.isfinite(command.trajectory.force).all()


def broken(kind: str) -> Situation:
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
        return replace(good, unfelt=(0, 1, 2))
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
def test_measurements_that_cannot_be(library: Library, kind: str) -> None:
    command = OnlineController(TASK, library, OnlineSettings()).tick(broken(kind))
    assert command.winner == SAFE
    assert command.warning.startswith("safe stance: ")
    assert WORDS[kind] in command.warning
    force = command.trajectory.force[0]
    assert np.isfinite(force).all()
    assert force[:, 2].sum() == pytest.approx(TASK.weight)
    assert command.trajectory.gait.contact.all()


def test_a_leg_without_contact_is_not_stood_on(library: Library) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    command = controller.tick(replace(situation(TASK), unfelt=(2,)))
    assert "LH without contact" in command.warning
    assert not command.trajectory.gait.contact[0, 2]
    assert (command.trajectory.force[0, 2] == 0).all()


def test_where_the_plan_before_slows_down_others_are_looked_at(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a steady walk it is enough that it goes on, if it does so as fast as is asked for."""
    controller = OnlineController(TASK, library, OnlineSettings())
    run_loop(controller, TASK, 0.8)
    last, here = controller._last, controller._expected
    assert last is not None
    told = Situation(here.state, here.start.toes, last.toes[0], last.gait.contact[0])
    tried = {}
    for slack in (tick._STEADY, 0.0):  # no plan is as fast as that to the last digit
        monkeypatch.setattr(tick, "_STEADY", slack)
        controller._last, controller._expected, controller._since = last, here, 0
        command = controller.tick(told)
        assert command.holds
        tried[slack] = command.tried
    assert tried[0.0] > 1 == tried[0.03]


@pytest.mark.parametrize(("name", "first"), [("trot", 2), ("stand", 1)])
def test_a_gait_goes_on_where_its_qps_led(name: str, first: int) -> None:
    """None is solved twice; a first one that is far off has no second before others were tried."""
    state = TASK.start.state.copy()
    state[VELOCITY] = [-0.5, 0.0, 0.0]
    task = replace(horizon_of(TASK), start=Start(state, TASK.start.toes))
    trials, gait = GaitTrials(task, 8e-3), named(name, task)
    program, budget = trials.program(task, gait), Budget(2000)
    progress = trials.begun(task, program, None)
    early = trials.attempt(task, program, progress, 2, budget)
    assert early is not None
    assert not early.holds
    assert budget.qps == first
    late = trials.attempt(task, program, progress, 4, budget, elastic=True)
    assert late is not None
    assert late.holds
    assert not progress.softly
    whole = Budget(2000)
    again = trials.begun(task, program, None)
    assert trials.attempt(task, program, again, 4, whole, elastic=True) is not None
    assert budget.qps == whole.qps == progress.qps
    np.testing.assert_allclose(again.here.state, progress.here.state, atol=1e-6)


@pytest.mark.parametrize(("step", "qps"), [(0.08, 1), (0.12, 2)])
def test_longer_intervals_may_miss_by_more_at_first(step: float, qps: int) -> None:
    """First QPs of heavy robots, whose intervals are long, are far off and mended by a second."""
    state = TASK.start.state.copy()
    state[VELOCITY] = [-0.5, 0.0, 0.0]
    task = replace(horizon_of(TASK), step=step, start=Start(state, TASK.start.toes))
    trials, budget = GaitTrials(task, 8e-3), Budget(2000)
    program = trials.program(task, named("stand", task))
    found = trials.attempt(task, program, trials.begun(task, program, None), 2, budget)
    assert found is not None
    assert budget.qps == qps


@pytest.mark.parametrize("effort", [0, 200, 1400])
def test_effort_bounds_the_qps_of_a_tick(library: Library, effort: int) -> None:
    """From a state that no gait can answer, every candidate is tried until the effort is spent."""
    settings = OnlineSettings(effort=effort)
    controller = OnlineController(TASK, library, settings)
    start = situation(TASK)
    state = start.state.copy()
    state[VELOCITY] = [-4.0, 3.0, -1.0]
    command = controller.tick(replace(start, state=state))
    assert command.qps <= effort // 60
    assert np.isfinite(command.trajectory.force).all()
    assert command.warning


def test_a_push_that_nobody_survives_is_a_fall(library: Library) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    loop = run_loop(controller, TASK, 2.0, pushed(0.5, 0, -6.0))
    assert loop.fell is not None
    assert not recovered(loop, TASK)
    whole = sampled_task(TASK, len(loop.trajectory.state) - 1)
    told = failures(check_loop(whole, loop.trajectory, loop.pushed))
    assert "loop.upright" in told or "loop.height" in told


@pytest.mark.parametrize("name", ["forest", "boosting", "network"])
def test_trained_strategies_rank_gaits(library: Library, name: StrategyName) -> None:
    """The gait of a stored situation comes first, or near; no gait comes twice."""
    ranking = trained(name, library, 0)
    found = 0
    for k in range(len(library)):
        ranked = ranking.ranked(library.features[k], 5)
        gaits = [library.contact[index].tobytes() for index in ranked]
        assert len(set(gaits)) == len(gaits)
        found += library.contact[k].tobytes() in gaits
    assert found > 0.8 * len(library)
    again = trained(name, library, 0).ranked(library.features[0], 5)
    np.testing.assert_array_equal(again, ranking.ranked(library.features[0], 5))


def test_without_sections_every_strategy_ranks_nothing(library: Library) -> None:
    empty = library.first(0)
    for name in ("knn", "forest"):
        assert len(trained(name, empty, 0).ranked(library.features[0], 5)) == 0


@pytest.mark.parametrize("velocity", [(-1.0, 0, 0), (1.8, 0.5, 0), (0, 0, 0)])
def test_the_safe_stance_keeps_the_body_upright(velocity: tuple[float, float, float]) -> None:
    """It brakes without turning over, where equal forces would, and keeps to the cones."""
    start = TASK.start
    state = start.state.copy()
    state[VELOCITY], state[10] = velocity, -1.4  # pitching back
    task = replace(horizon_of(TASK), start=Start(state, start.toes))
    stance = safe_stance(task)
    force = stance.force[0]
    body = task.body
    inverse = body.inverse
    after = moved(
        body.mass, body.gravity, body.inertia, inverse, 0.08, 16, state, start.toes, force
    )
    assert abs(after[10]) < 0.6
    assert np.hypot(*after[3:5]) < 0.8 * np.hypot(*velocity[:2]) + 0.05
    sideways = np.linalg.norm(force[:, :2], axis=1)
    assert (sideways <= task.ground.friction * force[:, 2] + 1e-9).all()
    assert np.abs(force).max() <= body.force_limit + 1e-9


def test_the_safe_stance_leaves_legs_that_are_out_of_reach() -> None:
    start = TASK.start
    toes = start.toes.copy()
    toes[1, 0] += 0.3
    stance = safe_stance(replace(horizon_of(TASK), start=Start(start.state, toes)))
    assert stance.gait.contact[0].tolist() == [True, False, True, True]
    assert (stance.force[0, 1] == 0).all()
    assert stance.toes[1, 1, 0] < toes[1, 0] - 0.2  # it comes down in reach
