"""Plans between knots where a push is felt, measurements that are dropped, toes at their edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walk_tasks import LEGS, named, shorter, walk_task

from benchmarks.walking.recovery_study import Study, run_study
from climbplan.walking.check.checker import LOOP_LIMITS
from climbplan.walking.check.reference_dynamics import integrate_knot, transform_toes_to_body
from climbplan.walking.kernels.body import integrate_rk4
from climbplan.walking.kernels.continuous_rollout import roll_out_horizon
from climbplan.walking.kernels.parameters import GaitHorizon
from climbplan.walking.offline.sqp import solve_gait
from climbplan.walking.online.closed_loop import (
    LoopResult,
    LoopScenario,
    Push,
    has_recovered,
    simulate_loop,
)
from climbplan.walking.online.controller import OnlineController, OnlineSettings
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.gait_adaptation import find_reachable_legs
from climbplan.walking.online.library import SectionLibrary, build_library
from climbplan.walking.online.run import build_scenario, build_settings
from climbplan.walking.online.stance import (
    LIFT_OFF_VIOLATION,
    StancePhase,
    ToeStance,
    build_stance,
    limit_landing,
)
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import POSITION, VELOCITY, Start

TASK = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)


@pytest.fixture(scope="module")
def library() -> SectionLibrary:
    return build_library(TASK, 3, 0, gaits=0)


def walked(
    library: SectionLibrary, world: LoopScenario, duration: float = 1.4, seed: int = 0
) -> LoopResult:
    controller = OnlineController(TASK, library, OnlineSettings())
    return simulate_loop(controller, TASK, duration, world, seed=seed)


@pytest.mark.parametrize("delay", [1, 4, 6])
def test_a_push_is_planned_for_before_the_next_knot(library: SectionLibrary, delay: int) -> None:
    push = Push(0.81, np.array([-0.5, 0.2, 0]))  # 10 ms after a knot
    world = LoopScenario(pushes=[push], delay_samples=delay)
    loop = walked(library, world)
    between = loop.tick_samples[loop.tick_samples % TASK.samples != 0]
    np.testing.assert_array_equal(between, [163])  # the sample after it
    assert loop.tick_samples[-1] % TASK.samples == 0  # knots stay where they were
    assert has_recovered(loop, TASK)
    # What was predicted for the beginning of each plan came true, but for one in flight
    aware = np.arange(len(loop.true_states)) != (
        np.flatnonzero(loop.tick_samples == 160)[0] if delay > 1 else -1
    )
    np.testing.assert_allclose(loop.estimated_states[aware], loop.true_states[aware], atol=1e-3)
    later = walked(library, replace(world, replan_at_push=False))
    assert (later.tick_samples % TASK.samples == 0).all()
    first = next(s for s in range(163, 200) if off(loop, later, s) > 1e-6)
    assert first == 163 + delay


def off(one: LoopResult, other: LoopResult, sample: int) -> float:
    return float(np.abs(one.trajectory.force[sample] - other.trajectory.force[sample]).max())


def test_a_push_too_late_in_an_interval_waits_for_the_knot(library: SectionLibrary) -> None:
    world = LoopScenario(pushes=[Push(0.875, np.array([-0.5, 0, 0]))], delay_samples=4)
    loop = walked(library, world)
    assert (loop.tick_samples % TASK.samples == 0).all()


def test_nobody_stands_that_swings_until_the_next_knot(library: SectionLibrary) -> None:
    world = LoopScenario(pushes=[Push(0.81, np.array([-0.8, 0, 0]))], delay_samples=1)
    loop = walked(library, world)
    contact = loop.trajectory.gait.contact
    assert not (contact[162:177] & ~contact[161]).any()


def test_a_shorter_first_interval_is_rolled_out_as_such() -> None:
    task = replace(shorter(TASK, 5), first=0.03)
    np.testing.assert_allclose(task.steps, [0.03, 0.08, 0.08, 0.08, 0.08])
    found = solve_gait(task, named("trot", task), None, 20).trajectory
    assert found is not None
    for n, dt in enumerate(task.steps):
        after = integrate_knot(task.body, "mean", dt, found.state[n], found.toes[n], found.force[n])
        np.testing.assert_allclose(found.state[n + 1], after, atol=1e-8)


def test_an_estimator_that_is_hit_beyond_its_range_is_waited_for(library: SectionLibrary) -> None:
    push = Push(0.81, np.array([-1.5, 0, 0]))  # 300 m/s^2: the accelerometer says 157
    for quality, last in ((SensorQuality(foot_velocity_std=0), 169), (SensorQuality(), 163)):
        loop = walked(
            library, LoopScenario(pushes=[push], delay_samples=1, estimation=quality), 1.0
        )
        between = loop.tick_samples[loop.tick_samples % TASK.samples != 0]
        # By joint velocities it is known at once
        assert 163 + (quality.foot_velocity_std == 0) <= between[0] <= last


def test_dropped_measurements_are_bridged(library: SectionLibrary) -> None:
    push = Push(0.805, np.array([-0.3, 0, 0]))
    world = LoopScenario(dropout_probability=0.3, delay_samples=2)
    loop = walked(library, world, 1.6)
    # Nothing disturbs: what is predicted from older measurements comes true
    np.testing.assert_allclose(loop.estimated_states, loop.true_states, atol=1e-5)
    pushed = walked(
        library,
        replace(world, dropout_probability=0.5, pushes=[push], replan_at_push=False),
        1.6,
        seed=3,
    )
    known = np.abs(pushed.estimated_states - pushed.true_states)[:, VELOCITY].max(axis=1)
    assert (known > 0.25).sum() >= 1  # a plan that did not know of the push
    assert known[-1] < 1e-4
    assert pushed.fall_time is None
    again = walked(
        library,
        replace(world, dropout_probability=0.5, pushes=[push], replan_at_push=False),
        1.6,
        seed=3,
    )
    np.testing.assert_array_equal(again.trajectory.state, pushed.trajectory.state)


def test_toes_at_the_edge_let_go() -> None:
    state = TASK.start.state.copy()
    stance = build_stance(TASK, TASK.start.toes.copy())
    assert not stance.find_unreachable_feet(TASK, state).any()
    state[0] += TASK.body.toe_half[0] + LIFT_OFF_VIOLATION - 1e-3
    assert not stance.find_unreachable_feet(TASK, state).any()
    state[0] += 2e-3
    legs = stance.find_unreachable_feet(TASK, state)
    assert legs.all()
    legs[2:] = False
    let_go = stance.lift_legs(legs, stance.phase.force, stance.toes, 0.0)
    np.testing.assert_array_equal(let_go.phase.contact, ~legs)
    assert (let_go.phase.force[:2] == 0).all()
    down = let_go.start_phase(TASK, state, stance.phase)
    reached = down.toes[:2, 0] - state[0] - TASK.body.toe_center[:2, 0]
    assert (np.abs(reached) < TASK.body.toe_half[0]).all()


def test_letting_go_keeps_toes_within_what_verification_allows(library: SectionLibrary) -> None:
    world = LoopScenario(pushes=[Push(0.82, np.array([-2.8, 0, 0]))], delay_samples=4)
    far = walked(library, replace(world, replan_at_push=False, lift_unreachable_feet=False))
    near = walked(library, replace(world, replan_at_push=False))
    assert far.reach_violation > 0.02
    assert near.reach_violation <= LIFT_OFF_VIOLATION + 1e-9


def test_who_is_left_braces_where_legs_let_go() -> None:
    """As planned the others' forces would turn the body by 7 rad/s within 50 ms."""
    state, toes = TASK.start.state.copy(), TASK.start.toes.copy()
    toes[0, 0] += TASK.body.toe_half[0] + LIFT_OFF_VIOLATION + 1e-3
    stance = build_stance(TASK, toes)
    after = stance.lift_unreachable_feet(TASK, state, 0.25)
    np.testing.assert_array_equal(after.phase.contact, [False, True, True, True])
    arms = toes - state[POSITION] - 0.5 * TASK.dt * state[VELOCITY]
    moments = [np.cross(arms, one.phase.force).sum(axis=0) for one in (stance, after)]
    assert np.linalg.norm(moments[1]) < 0.2
    planned = np.where(after.phase.contact[:, None], stance.phase.force, 0.0)
    assert np.linalg.norm(np.cross(arms, planned).sum(axis=0)) > 2.0
    assert after.phase.force[:, 2].sum() > 0.8 * TASK.weight
    # It comes down where it is in reach again
    assert after.phase.landing[0, 0] < state[0] + (TASK.body.toe_center + TASK.body.toe_half)[0, 0]
    alone = replace(stance, phase=replace(stance.phase, contact=np.array([1, 0, 0, 1], bool)))
    assert (
        np.abs(alone.lift_unreachable_feet(TASK, state, 0.25).phase.force).max() < 5.0
    )  # one leg would turn it


@pytest.mark.parametrize("speed", [1.8, 0.3, -1.0])
def test_toes_come_down_where_they_stay_in_reach(speed: float) -> None:
    body, state = TASK.body, TASK.start.state.copy()
    state[VELOCITY] = [speed, -0.2, 0.0]
    for asked in (-1.0, 0.0, 1.0):
        toes = limit_landing(TASK, state, state[POSITION] + body.toe_center + asked)
        for later in (0.0, TASK.dt):
            spots = toes - state[POSITION] - later * state[VELOCITY] - body.toe_center
            assert (np.abs(spots[:, :2]) < body.toe_half[:2] + 0.01 + 1e-9).all()
    fair = state[POSITION] + body.toe_center + np.array([0.5 * speed * TASK.dt, 0, 0])
    np.testing.assert_allclose(limit_landing(TASK, state, fair)[:, :2], fair[:, :2], atol=0.01)


def test_legs_that_the_body_moves_away_from_are_not_stood_on() -> None:
    task = replace(shorter(TASK, 5), start=TASK.start)
    state = TASK.start.state.copy()
    state[VELOCITY] = [-1.0, 0, 0]
    ahead = TASK.start.toes + np.array([0.06, 0, 0])
    pushed = replace(task, start=Start(state, ahead))
    assert not find_reachable_legs(pushed).any()  # 8 cm more until the knot's end
    assert find_reachable_legs(replace(pushed, first=0.02)).all()
    assert find_reachable_legs(replace(pushed, workspace_over_stance=False)).all()


def test_toes_are_in_their_boxes_between_knots_too() -> None:
    """A body that rolls out and back within an interval takes its toes along."""
    body = TASK.body
    state = TASK.start.state.copy()
    state[9:12] = [3.0, 0, 0]
    force = np.zeros((1, LEGS, 3))
    force[0, :, 2] = TASK.weight / LEGS
    force[0, [0, 2], 2] -= 12.0
    force[0, [1, 3], 2] += 12.0
    toes = np.tile(TASK.start.toes, (2, 1, 1))
    toes[:, :, 1] += np.sign(toes[:, :, 1]) * 0.075
    contact = np.ones((1, LEGS), bool)
    steps = np.array([0.08])
    states, found = roll_out_horizon(
        body.parameters,
        GaitHorizon(steps, False, contact, state, False),
        body.toe_workspace,
        4,
        toes,
        force,
    )
    here, worst = state, 0.0
    for _ in range(3):
        here = integrate_rk4(body.parameters, 0.02, 1, here, toes[0], force[0])
        off = np.abs(transform_toes_to_body(here, toes[0]) - body.toe_center) - body.toe_half
        worst = max(worst, float(off.max()))
    assert worst > 0.001
    assert found == pytest.approx(worst, abs=1e-12)
    last = integrate_rk4(body.parameters, 0.02, 1, here, toes[0], force[0])
    np.testing.assert_allclose(states, [state, last], atol=1e-12)


def test_where_no_plan_holds_legs_come_down_earlier(library: SectionLibrary) -> None:
    """And the next tick follows then, not at the knot that would have been."""
    loop = walked(
        library, LoopScenario(pushes=[Push(0.81, np.array([-2.8, 0, 0]))], delay_samples=4)
    )
    early = [k for k, command in enumerate(loop.commands[:-1]) if command.first_interval == 0.04]
    assert early
    for k in early:
        later = loop.tick_samples[k + 1] - loop.tick_samples[k]
        assert later <= 8
    assert loop.reach_violation <= LIFT_OFF_VIOLATION


@pytest.mark.slow
@pytest.mark.parametrize("push", [(-2.8, 0, 0), (-1.5, 0, 0), (0, 1, 0)])
def test_pushed_walks_keep_within_what_verification_passes(push: tuple[float, ...]) -> None:
    world = LoopScenario(delay_samples=4, estimation=SensorQuality())
    built = build_library(TASK, 12, 0)
    trials = run_study(Study(TASK, built, np.array(push, float), 10, world=world))
    assert max(trial.overreach for trial in trials) <= LOOP_LIMITS["workspace.standing"].value
    assert sum(trial.recovered for trial in trials) >= 9


def test_a_stance_is_redirected_until_its_knot() -> None:
    stance = build_stance(TASK, TASK.start.toes.copy())
    landing = TASK.start.toes + np.array([0.06, 0.0, 0.0])
    swinging = replace(stance.phase, contact=np.array([1, 1, 0, 0], bool), landing=landing)
    stance = replace(stance, phase=swinging)
    wanted = np.array([1, 0, 1, 0], bool)
    phase = StancePhase(wanted, np.ones((LEGS, 3)), TASK.start.toes + 0.1)
    after: ToeStance = stance.replace_plan(TASK, phase, 0.5, 0.75)
    np.testing.assert_array_equal(after.phase.contact, [True, False, False, False])
    np.testing.assert_array_equal(after.phase.landing, phase.landing)
    # Those in the air go on from where they are; the interval ends sooner than it was to
    np.testing.assert_allclose(after.toes[:, 0] - stance.toes[:, 0], [0, 0, 0.03, 0.03])
    np.testing.assert_allclose(
        after.compute_toes(TASK, 0.75)[2:], stance.compute_toes(TASK, 0.5)[2:]
    )
    np.testing.assert_allclose(
        after.compute_toes(TASK, 0.875)[2:, :2], after.toes[2:, :2] + [0.035, 0.05]
    )
    np.testing.assert_allclose(after.compute_toes(TASK, 1.0)[2:, :2], phase.landing[2:, :2])
    assert (
        after.compute_toes(TASK, 0.875)[2, 2] < stance.compute_toes(TASK, 0.5)[2, 2]
    )  # on its way down


def test_what_a_spec_says_of_pushes() -> None:
    loop = {
        "replan_trigger": "knots",
        "dropout_probability": 0.1,
        "lift_unreachable_stance_feet": False,
    }
    spec = MpcSpec.model_validate({"kind": "mpc", "solver": {"method": "online"}, "loop": loop})
    world = build_scenario(spec.loop, TASK)
    assert (world.replan_at_push, world.dropout_probability, world.lift_unreachable_feet) == (
        False,
        0.1,
        False,
    )
    plain = build_scenario(MpcSpec.model_validate({"kind": "mpc"}).loop, TASK)
    assert (plain.replan_at_push, plain.dropout_probability, plain.lift_unreachable_feet) == (
        True,
        0.0,
        True,
    )


def test_a_tick_may_weigh_the_height_more_than_the_task(library: SectionLibrary) -> None:
    loop = {"height_weight": 250.0}
    spec = MpcSpec.model_validate({"kind": "mpc", "solver": {"method": "online"}, "loop": loop})
    heavy = OnlineController(TASK, library, build_settings(spec)).task.weights
    plain = OnlineController(TASK, library, OnlineSettings()).task.weights
    assert (heavy.height, plain.height) == (250.0, TASK.weights.height)
    np.testing.assert_array_equal(heavy.velocity, TASK.weights.velocity)
