"""The loop's world: delay, compliant legs, estimation, lost contact."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError
from walk_tasks import LEGS, walk_task

from climbplan.errors import LimitReached, SpecError
from climbplan.walking.check.checker import check_loop, format_failures
from climbplan.walking.online.admittance import AdmittanceController, AdmittanceGains, limit_forces
from climbplan.walking.online.candidate_selection import SAFE_STANCE, Command
from climbplan.walking.online.closed_loop import (
    ContactLoss,
    LoopResult,
    LoopScenario,
    Push,
    has_recovered,
    simulate_loop,
)
from climbplan.walking.online.controller import OnlineController, OnlineSettings
from climbplan.walking.online.estimation import SensorQuality
from climbplan.walking.online.library import SectionLibrary, build_library
from climbplan.walking.online.run import build_scenario
from climbplan.walking.online.state_feedback import StateNoise
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.problem.problem import build_sampled_task
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.schema.model import MpcSpec
from climbplan.walking.task.task import VELOCITY

TASK = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)


@pytest.fixture(scope="module")
def library() -> SectionLibrary:
    return build_library(TASK, 3, 0, gaits=0)


def walked(
    library: SectionLibrary, world: LoopScenario, duration: float = 1.2, seed: int = 0
) -> LoopResult:
    controller = OnlineController(TASK, library, OnlineSettings())
    return simulate_loop(controller, TASK, duration, world, seed=seed)


def told(loop: LoopResult, world: LoopScenario) -> str:
    """What the checks of a recorded loop say; empty if all pass."""
    whole = build_sampled_task(TASK, len(loop.trajectory.state) - 1)
    pushed = loop.push_velocity
    assert (pushed.any() and world.pushes) or not pushed.any()
    return format_failures(check_loop(whole, loop.trajectory, pushed))


@pytest.mark.parametrize("delay", [3, 16, 20])
def test_a_delay_is_compensated(library: SectionLibrary, delay: int) -> None:
    """Without noise and pushes what is predicted over the delay comes true."""
    world = LoopScenario(delay_samples=delay)
    loop = walked(library, world)
    assert loop.fall_time is None
    np.testing.assert_allclose(
        loop.estimated_states[: len(loop.true_states)], loop.true_states, atol=1e-9
    )
    assert told(loop, world) == ""
    speed = loop.trajectory.state[:, VELOCITY][:, 0]
    assert (speed[: delay + 1] < 1e-9).all()  # nothing is commanded before
    assert speed[-1] > 1.5


def test_a_delay_that_is_not_compensated_tells(library: SectionLibrary) -> None:
    loop = walked(library, LoopScenario(delay_samples=6, compensate_delay=False))
    assert (
        np.abs(loop.estimated_states[: len(loop.true_states)] - loop.true_states)[:, VELOCITY].max()
        > 0.1
    )


def test_compliant_legs_under_admittance_control_walk(library: SectionLibrary) -> None:
    world = LoopScenario(admittance=AdmittanceGains(), pushes=[Push(0.6, np.array([-0.5, 0, 0]))])
    loop = walked(library, world, 2.0)
    assert has_recovered(loop, TASK)
    assert told(loop, world) == ""
    plans = np.array([c.trajectory.force[0] for c in loop.commands])
    samples = np.arange(len(loop.trajectory.state) - 1)
    planned = plans[np.searchsorted(loop.tick_samples, samples, side="right") - 1]
    off = np.abs(loop.trajectory.force[:-1] - planned).max()
    assert off > 0.1  # forces are the legs', not the plan's


def test_admittance_gains_trade_position_for_force() -> None:
    """Held off its place, a leg that tracks forces gives way and one for places does not."""
    planned, ahead = np.zeros((LEGS, 3)), np.zeros((LEGS, 3))
    planned[:, 2], ahead[:, 2] = 15.0, 0.005
    ends = {}
    for name, gains in {
        "force": AdmittanceGains(stiffness=0.0),
        "place": AdmittanceGains(force=0.0),
        "both": AdmittanceGains(),
    }.items():
        legs = AdmittanceController(gains, LEGS)
        for _ in range(400):
            force = legs.compute_forces(planned, ahead, np.zeros((LEGS, 3)))
            legs.integrate(planned, force, 0.005)
        ends[name] = float(force[0, 2])
    assert ends["force"] == pytest.approx(15.0, abs=1e-3)
    assert ends["place"] == pytest.approx(15.0 + 3000 * 0.005)
    # K e = Kf k (0.005 - e) at rest
    e = 0.3 * 3000 * 0.005 / (400 + 0.3 * 3000)
    assert ends["both"] == pytest.approx(15.0 + 3000 * (0.005 - e), abs=1e-3)


def test_the_ground_neither_pulls_nor_holds_beyond_friction() -> None:
    force = np.array([[0, 0, -5.0], [30.0, 40.0, 10.0], [5.0, 0, 90.0], [1.0, 1.0, 9.0]])
    contact = np.array([True, True, True, False])
    given = limit_forces(force, contact, 0.5, 40.0)
    np.testing.assert_allclose(given[0], 0)
    np.testing.assert_allclose(given[1], [3.0, 4.0, 10.0])
    np.testing.assert_allclose(given[2], [5.0, 0, 40.0])
    np.testing.assert_allclose(given[3], 0)


def test_estimation_in_the_loop(library: SectionLibrary) -> None:
    world = LoopScenario(estimation=SensorQuality(), pushes=[Push(0.6, np.array([-0.5, 0, 0]))])
    loop = walked(library, world, 2.0, seed=3)
    assert loop.fall_time is None
    off = (loop.estimated_states - loop.true_states)[:, VELOCITY]
    assert 1e-4 < np.sqrt((off**2).mean()) < 0.1
    assert told(loop, world) == ""


@pytest.mark.parametrize("legs", [(1,), (0, 1, 2), (0, 1, 2, 3)])
def test_contact_that_is_never_made(library: SectionLibrary, legs: tuple[int, ...]) -> None:
    """A named warning, in the end a safe stance, never a NaN."""
    world = LoopScenario(
        contact_losses=[ContactLoss(0.24, leg) for leg in legs],
        noise=StateNoise(0.01, 0.002, 0.01, 0.001),
    )
    loop = walked(library, world, 0.8)
    assert np.isfinite(loop.trajectory.state).all()
    assert (loop.trajectory.force[60:, list(legs)] == 0).all()
    words = [command.warning for command in loop.commands[4:]]
    names = [TASK.body.leg_names[leg] for leg in legs]
    assert any(all(name in word for name in names) and "contact" in word for word in words)
    assert all(np.isfinite(command.trajectory.force).all() for command in loop.commands)
    if len(legs) > 2:
        assert any(command.source == SAFE_STANCE for command in loop.commands)


def test_what_a_spec_puts_between_controller_and_robot() -> None:
    spec = MpcSpec.model_validate(
        {
            "kind": "mpc",
            "task": {"integrator": "mean"},
            "solver": {"method": "online"},
            "loop": {
                "delay": 0.021,
                "leg_model": "admittance",
                "admittance": {"force": 0.5},
                "estimation": "ekf",
                "sensors": {"toe": 0.002},
                "lost_contacts": [{"time": 1.5, "leg": "LH"}],
            },
        }
    )
    world = build_scenario(spec.loop, TASK)
    assert world.delay_samples == 4
    assert world.admittance is not None
    assert world.admittance.force == 0.5
    assert world.estimation is not None
    assert world.estimation.toe == 0.002
    assert world.contact_losses == [ContactLoss(1.5, 2)]
    both = {"estimation": "ekf", "noise": {"velocity": 0.1}}
    with pytest.raises(ValidationError, match="without an estimator"):
        MpcSpec.model_validate({"kind": "mpc", "loop": both})


def test_a_duration_below_half_a_knot_is_one_knot(library: SectionLibrary) -> None:
    assert walked(library, LoopScenario(), duration=1e-9).num_ticks == 1


def test_a_deadline_keeps_what_was_walked(library: SectionLibrary) -> None:
    controller = OnlineController(TASK, library, OnlineSettings())
    loop = simulate_loop(controller, TASK, 600.0, deadline=time.monotonic() + 0.2)
    assert loop.cut_short
    assert loop.fall_time is None
    assert 1 <= loop.num_ticks < 600 / TASK.dt
    assert len(loop.trajectory.state) - 1 > loop.tick_samples[-1]
    assert not walked(library, LoopScenario(), 0.3).cut_short
    with pytest.raises(LimitReached, match="0 of 5 walks"):
        build_library(TASK, 5, 0, deadline=time.monotonic() - 1.0)


@pytest.mark.parametrize(
    ("late", "key"),
    [
        ({"pushes": [{"time": 2.0, "velocity": [1, 0, 0]}]}, "loop.pushes.0.time"),
        ({"lost_contacts": [{"time": 9, "leg": "LF"}]}, "loop.lost_contacts.0.time"),
    ],
)
def test_what_comes_after_the_end_is_a_mistake(
    late: dict[str, object], key: str, tmp_path: Path
) -> None:
    spec = {"kind": "mpc", "loop": {"duration": 2.0, **late}}
    path = tmp_path / "late.yaml"
    path.write_text(yaml.safe_dump(spec, sort_keys=False))
    with pytest.raises(SpecError) as caught:
        load_mpc(path)
    (mistake,) = caught.value.mistakes
    assert mistake.key == key
    assert mistake.line is not None
    assert "before the end at 2 s" in mistake.message


class Blind(OnlineController):
    """From a tick on measurements are no numbers."""

    ticks = 0

    def tick(self, situation: TickInput) -> Command:
        self.ticks += 1
        if self.ticks > 8:
            situation = replace(situation, state=np.full(12, np.nan))
        return super().tick(situation)


def test_without_measurements_the_body_comes_to_rest(library: SectionLibrary) -> None:
    """Where it would be is reckoned on: a brake that never ended would turn it back and over."""
    loop = simulate_loop(Blind(TASK, library, OnlineSettings()), TASK, 2.0)
    assert loop.fall_time is None
    assert all("not a number" in command.warning for command in loop.commands[8:])
    speed = loop.trajectory.state[:, VELOCITY]
    assert speed[130, 0] > 1.6
    assert np.abs(speed[-60:, :2]).max() < 0.2
    assert np.abs(loop.trajectory.state[-1, 6:8]).max() < 0.3
