"""Closed-loop execution: what it waits for, what it presses with, and that it stands."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from concurrent.futures import wait
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.forces.statement import build_robot_forces, check_forces
from climbplan.climb.plan.climb_plan import ClimbPlan, Instants
from climbplan.climb.plan.file import write_climb
from climbplan.climb.plan.played import START, compute_true_angles, sample_instants
from climbplan.climb.schema.force import ForcePlannerSpec
from climbplan.climb.simulation.executive.executive import ClimbExecutive
from climbplan.climb.simulation.executive.replanning import MeasuredStance, correct_drift
from climbplan.climb.simulation.executive.schedule import build_schedule
from climbplan.climb.simulation.executive.settings import (
    ExecutiveEvent,
    ExecutiveSettings,
    describe_event,
)
from climbplan.climb.simulation.executive.stance_forces import solve_stance_forces
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.risk.estimation import (
    RiskEstimate,
    ScenarioOutcome,
    format_risk,
)
from climbplan.climb.simulation.worlds.nominal_world import build_nominal_world
from climbplan.climb.simulation.worlds.uncertainty import Uncertainty, build_layout
from climbplan.errors import Unresolved, UsageError
from climbplan.mechanics.stiffness import limb_compliance
from climbplan.robots.kinematics import jacobian_world, standing_inverse, toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions, FrictionLoss, WeakMotor
from climbplan.simulation.motors import compute_max_torque

Planned = Callable[..., ClimbPlan]
ROOT = Path(__file__).parents[2]
_STEP = 0.02  # [s]
_TOUCH = 8.0  # [N] of a toe that has met its surface


class IdealRobot:
    """A robot whose body is where it is planned and whose toes bear what they are to bear.

    A toe in the air touches once its command presses it with `_TOUCH` onto the surface that it
    goes to or has left.
    """

    def __init__(self, plan: ClimbPlan, executive: ClimbExecutive, depth: Array) -> None:
        """Start; depth: (N,) of surfaces behind their planned places [m], inf of none."""
        self.plan, self.executive, self.depth = plan, executive, depth
        self._schedule = build_schedule(plan, 0.03)
        self.places = plan.rounds.toes[0].copy()

    def read(self, sample: int, force: Array) -> tuple[Array, Array]:
        """Return angles and motor torques (N, J) of toes that bear forces (N, 3)."""
        plan, command = self.plan, self.executive.command
        com, rpy = plan.trajectory.com[sample], plan.trajectory.rpy[sample]
        inverse = standing_inverse(plan.robot, com, rpy, self.places, self._schedule.normal[sample])
        bears = np.asarray(force.any(axis=1))[:, None]
        angles = np.where(bears, inverse.best(), command)
        torque = np.einsum("nij,ni->nj", jacobian_world(plan.robot, rpy, angles), force)
        return angles, self.executive.gravity_torque[sample] - torque

    def step(self) -> None:
        """Let the executive read what its last commands cause."""
        plan, executive, schedule = self.plan, self.executive, self._schedule
        sample = executive.sample
        contact = plan.trajectory.contact[sample]
        force = executive.target_force * contact[:, None]
        toes = toe_world(
            plan.robot,
            plan.trajectory.com[sample],
            plan.trajectory.rpy[sample],
            executive.command,
        )
        jacobian = jacobian_world(plan.robot, plan.trajectory.rpy[sample], executive.command)
        softness = limb_compliance(plan.robot, jacobian)  # walls face along x
        for limb in np.flatnonzero(~contact):
            contacts = plan.trajectory.contact[:, limb]
            landing = sample + int(np.argmax(contacts[sample:]))
            left = int(np.flatnonzero(contacts[:sample])[-1])
            returns = any(event.kind == "retreated" for event in executive.events)
            stands, depth = (left, 0.0) if returns else (landing, self.depth[limb])
            normal, place = schedule.normal[stands, limb], schedule.path[stands, limb]
            if (place - toes[limb]) @ normal >= depth + _TOUCH * softness[limb, 0, 0]:
                force[limb] = _TOUCH * normal
                self.places[limb] = place - depth * normal
        executive.step(_STEP, *self.read(sample, force))


def test_gates_are_unload_lift_touch_of_each_limb_step(planned: Planned) -> None:
    plan = planned()
    contact = plan.trajectory.contact
    gates = build_schedule(plan, 0.03).gates
    assert [gate.kind for gate in gates] == ["unload", "lift", "touch"] * (plan.instants.count // 2)
    assert (np.diff([gate.sample for gate in gates]) > 0).all()
    for unload, lift, touch in zip(gates[::3], gates[1::3], gates[2::3], strict=True):
        assert contact[unload.sample].all()
        assert not contact[lift.sample : touch.sample, lift.limbs].any()
        assert contact[touch.sample].all()


def test_stance_forces_hold_on_the_friction_that_was_measured(planned: Planned) -> None:
    plan, no_load = planned(), np.zeros(6)
    instants = plan.instants
    slippery = 0.8 * instants.mu[0]
    found = solve_stance_forces(plan, 0, instants.toes[0], slippery, no_load)
    assert found is not None
    first = {f.name: getattr(instants, f.name)[:1] for f in fields(Instants)}
    row = Instants(**first | {"mu": slippery[None]})
    statement = build_robot_forces(plan.robot, ForcePlannerSpec(safety_friction=1.3), row)
    assert check_forces(statement, found.force[None]).worst[0] < 1e-6
    assert not found.force[instants.lifted[0]].any()


def test_stance_forces_carry_a_load_that_was_measured(planned: Planned) -> None:
    plan = planned()
    heavier = np.array([0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    light = solve_stance_forces(plan, START, plan.rounds.toes[0], plan.instants.mu[0], np.zeros(6))
    heavy = solve_stance_forces(plan, START, plan.rounds.toes[0], plan.instants.mu[0], heavier)
    assert light is not None
    assert heavy is not None
    assert heavy.force[:, 2].sum() - light.force[:, 2].sum() == pytest.approx(20.0, abs=1e-6)


def test_there_are_no_stance_forces_on_ice(planned: Planned) -> None:
    plan = planned()
    ice = np.full(plan.robot.limb_count, 0.02)
    assert solve_stance_forces(plan, 0, plan.instants.toes[0], ice, np.zeros(6)) is None


def test_a_toe_searches_a_surface_that_is_farther(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    depth = np.zeros(plan.robot.limb_count)
    limb = int(np.flatnonzero(plan.instants.lifted[0])[0])
    depth[limb] = 0.012
    robot = IdealRobot(plan, executive, depth)
    while not any(event.kind == "touched" for event in executive.events):
        assert executive.time < 20.0
        assert not executive.stopped
        robot.step()
    touched = next(event for event in executive.events if event.kind == "touched")
    assert touched.limb == limb
    assert touched.value == pytest.approx(depth[limb], abs=3e-3)
    # It presses on a soft limb until it counts as touched
    assert executive.time - executive.clock > 0.012 / ExecutiveSettings().search_speed


def test_a_robot_stops_where_a_toe_finds_no_surface(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    robot = IdealRobot(plan, executive, np.full(plan.robot.limb_count, np.inf))
    while not executive.finished:
        assert executive.time < 20.0
        robot.step()
    limb = int(np.flatnonzero(plan.instants.lifted[0])[0])
    name = plan.robot.limb_names[limb]
    assert executive.stopped == f"{name} finds no surface within 30 mm"
    # It stands again where it stood before
    assert [event.kind for event in executive.events][-4:-2] == ["retreated", "touched"]
    np.testing.assert_allclose(executive.contacts.pose.places, plan.rounds.toes[0], atol=5e-3)
    clock = executive.clock
    assert plan.trajectory.contact[: executive.sample + 1].all()
    robot.step()
    assert executive.clock == clock  # it holds where it is


def test_a_limb_that_still_carries_does_not_lift(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan, settings=ExecutiveSettings(patience=1.0))
    lift = next(gate for gate in build_schedule(plan, 0.03).gates if gate.kind == "lift")
    robot = IdealRobot(plan, executive, np.zeros(plan.robot.limb_count))
    while executive.clock < plan.trajectory.time[lift.sample] - 0.1:
        robot.step()
    force = executive.target_force.copy()
    force[lift.limbs] += 40.0 * plan.instants.normal[0, lift.limbs]
    while not executive.finished:
        executive.step(_STEP, *robot.read(executive.sample, force))
        assert executive.time < 20.0
    assert "still carries" in executive.stopped
    assert executive.clock == pytest.approx(plan.trajectory.time[lift.sample])


def test_a_robot_stops_once_a_toe_has_slid_off_its_foothold(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    robot = IdealRobot(plan, executive, np.zeros(plan.robot.limb_count))
    robot.step()
    lifted = int(np.flatnonzero(plan.instants.lifted[0])[0])
    limb = (lifted + 3) % plan.robot.limb_count
    for _ in range(10):  # down its wall
        robot.places[limb, 2] -= 6e-3
        robot.step()
    while not executive.finished:
        robot.step()
        assert executive.time < 20.0
    name = plan.robot.limb_names[limb]  # the estimate of the pose takes a part of 60 mm
    assert re.fullmatch(rf"{name} has slid 5\d mm off its foothold", executive.stopped)
    assert not any(event.kind == "touched" for event in executive.events)


def _stop_after_slide(plan: ClimbPlan, limb: int) -> ClimbExecutive:
    """Return an executive that has stopped, as a toe slid 60 mm down its wall."""
    executive = ClimbExecutive(plan)
    robot = IdealRobot(plan, executive, np.zeros(plan.robot.limb_count))
    robot.step()
    for _ in range(10):
        robot.places[limb, 2] -= 6e-3
        robot.step()
    while not executive.finished:
        robot.step()
        assert executive.time < 20.0
    return executive


def test_a_climb_goes_on_by_a_plan_from_where_a_toe_has_slid_to(planned: Planned) -> None:
    plan = planned()
    limb = (int(np.flatnonzero(plan.instants.lifted[0])[0]) + 3) % plan.robot.limb_count
    stopped = _stop_after_slide(plan, limb)
    following = stopped.replan()
    assert verify_plan(following.plan).passed
    np.testing.assert_allclose(following.plan.rounds.com[0], stopped.contacts.pose.com, atol=1e-12)
    np.testing.assert_allclose(
        following.plan.rounds.toes[0], stopped.contacts.pose.places, atol=1e-3
    )
    np.testing.assert_array_equal(following.plan.limits.goal_com, plan.limits.goal_com)
    assert following.plan.instants.lifted[0, limb]  # what has slid moves first
    # It begins with the commands that hold the robot, and fades them out
    np.testing.assert_allclose(following.motor_command, stopped.motor_command, atol=1e-12)
    robot = IdealRobot(following.plan, following, np.zeros(plan.robot.limb_count))
    while not any(event.kind == "touched" for event in following.events):
        robot.step()
        assert following.time < 20.0
        assert not following.stopped


def _turn_stance(plan: ClimbPlan, degrees: float) -> tuple[MeasuredStance, MeasuredStance]:
    """Return the first stance of a plan, and that as odometry that has drifted would measure it."""
    stance = MeasuredStance(
        com=plan.instants.com[1],
        rotation=rotation_world_body(plan.instants.rpy[1]),
        toes=plan.instants.toes[1],
        friction=np.ones(len(plan.terrain.surfaces)),
        load=np.zeros(6),
        instant=1,
        next_instant=2,
    )
    turn = Rotation.from_rotvec(np.deg2rad([0.0, 0.6, 0.8]) * degrees).as_matrix()
    com = stance.com + np.array([0.01, 0.0, 0.0])
    return stance, replace(
        stance,
        com=com,
        rotation=turn @ stance.rotation,
        toes=com + (stance.toes - stance.com) @ turn.T,
    )


def test_drift_of_the_attitude_is_corrected_by_surfaces(planned: Planned) -> None:
    plan = planned()
    true, drifted = _turn_stance(plan, 10.0)
    corrected = correct_drift(plan, drifted)
    # Walls face along x: turns about y and z and the place along x follow from them
    turn = corrected.rotation @ true.rotation.T
    assert np.rad2deg(Rotation.from_matrix(turn).magnitude()) < 0.5
    np.testing.assert_allclose(corrected.com[0], true.com[0], atol=1e-3)
    np.testing.assert_allclose(corrected.toes, true.toes, atol=6e-3)
    body = (corrected.toes - corrected.com) @ corrected.rotation
    np.testing.assert_allclose(body, (true.toes - true.com) @ true.rotation, atol=1e-12)


def test_surfaces_that_lie_elsewhere_are_no_drift(planned: Planned) -> None:
    plan = planned()
    stance, _ = _turn_stance(plan, 0.0)
    toes = stance.toes - 0.02 * plan.instants.normal[1]
    farther = replace(stance, toes=toes)
    assert correct_drift(plan, farther) is farther


def test_a_stance_with_less_friction_is_planned_with_it(planned: Planned) -> None:
    plan = planned()
    stopped = _stop_after_slide(plan, 0)
    region = int(plan.rounds.region[0, 0])
    stopped.contacts.friction[region] = 0.8
    found = stopped.replan().plan
    assert found.terrain.surfaces[region].friction == pytest.approx(
        0.8 * plan.terrain.surfaces[region].friction
    )


@pytest.mark.merge
def test_there_is_no_plan_from_a_stance_on_ice(planned: Planned) -> None:
    stopped = _stop_after_slide(planned(), 0)
    stopped.contacts.friction[:] = 0.05
    with pytest.raises(Unresolved, match="no plan from the measured stance"):
        stopped.replan()


def test_plans_begin_on_all_toes(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    robot = IdealRobot(plan, executive, np.zeros(plan.robot.limb_count))
    while plan.trajectory.contact[executive.sample].all():
        robot.step()
    for _ in range(50):  # until the limb has left
        robot.step()
    with pytest.raises(UsageError, match="is in the air: a plan begins on all toes"):
        executive.replan()


def test_motors_are_told_to_carry_their_links_too(planned: Planned) -> None:
    executive = ClimbExecutive(plan := planned())
    carried = (executive.motor_command - executive.command) * plan.robot.joint_stiffness
    share = 1 - plan.robot.structural_compliance_share
    np.testing.assert_allclose(carried * share, executive.gravity_torque[0], atol=1e-12)


def test_poor_stances_keep_a_part_of_all_margins(planned: Planned) -> None:
    plan = planned()
    parts = [
        solution.margin_fraction
        for factor in (1.0, 0.8, 0.7, 0.6, 0.5)
        if (
            solution := solve_stance_forces(
                plan, 0, plan.instants.toes[0], factor * plan.instants.mu[0], np.zeros(6)
            )
        )
    ]
    assert parts == sorted(parts, reverse=True)
    assert parts[0] >= 1.0 > parts[-1]


@pytest.mark.parametrize("engine_is_mujoco", [True, False])
def test_a_weak_motor_gives_its_share_of_torque(planned: Planned, engine_is_mujoco: bool) -> None:
    plan, weak = planned(), Conditions(weak_motors=(WeakMotor(2, 1, 0.6),))
    expected = plan.robot.max_torque.copy()
    expected[2, 1] *= 0.6
    if engine_is_mujoco:
        mujoco = pytest.importorskip("mujoco")
        model = mujoco.MjModel.from_xml_string(build_mjcf(plan, weak))
        limit = model.actuator_forcerange[: expected.size, 1].reshape(expected.shape)
    else:
        limit = compute_max_torque(plan.robot, weak)
    np.testing.assert_allclose(limit, expected, rtol=1e-6)


def test_readings_that_are_no_numbers_are_refused(planned: Planned) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    good = np.zeros_like(executive.command)
    with pytest.raises(ValueError, match="finite"):
        executive.step(_STEP, np.full_like(good, np.nan), good)
    with pytest.raises(ValueError, match="time step"):
        executive.step(0.0, good, good)


class StubNode:
    """What the node of ROS 2 uses of its base class: what it sends is kept."""

    def __init__(self, name: str) -> None:
        self.name, self.sent = name, [np.zeros(0)]
        self.errors: list[str] = []
        self.notes: list[str] = []

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: Elapsed(0))

    def create_publisher(self, kind: type, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=lambda message: self.sent.append(np.array(message.data)))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(
            error=lambda text, once: self.errors.append(text), info=self.notes.append
        )

    def create_subscription(self, *given: object) -> None:
        pass

    def create_timer(self, *given: object) -> None:
        pass


class Elapsed(int):
    """A time of ROS 2 [ns]."""

    def __sub__(self, other: int) -> Elapsed:
        return Elapsed(int(self) - int(other))

    @property
    def nanoseconds(self) -> int:
        return int(self)


@pytest.fixture
def node(planned: Planned, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return the node of ROS 2 of a plan, with stubs for the packages of ROS 2."""
    for name, members in {
        "rclpy": {},
        "rclpy.node": {"Node": StubNode},
        "sensor_msgs.msg": {"JointState": SimpleNamespace},
        "std_msgs.msg": {"Float64MultiArray": SimpleNamespace},
    }.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(ROOT / "examples" / "ros2")
    from closed_loop_climb import ClosedLoopClimb

    write_climb(planned(), tmp_path / "plan.h5")
    return ClosedLoopClimb(str(tmp_path / "plan.h5"))


def test_the_node_of_ros_2_commands_joints_in_their_order(planned: Planned, node: Any) -> None:
    plan = planned()
    executive = ClimbExecutive(plan)
    angles = compute_true_angles(plan, sample_instants(plan))[0]
    torques = executive.gravity_torque[0]
    shuffled = list(plan.robot.motor_names[::-1])
    node.tick()
    assert len(node.sent) == 1  # nothing before all joints were heard
    position, effort = angles.ravel()[::-1].tolist(), torques.ravel()[::-1].tolist()
    node.hear(SimpleNamespace(name=shuffled, position=position, effort=effort))
    node.tick()
    executive.step(0.01, angles, torques)
    np.testing.assert_allclose(node.sent[-1], executive.motor_command.ravel(), atol=1e-12)
    node.hear(SimpleNamespace(name=shuffled, position=position, effort=[]))
    assert "has no effort" in node.errors[0]


def _let_node_stop(node: Any, replan: Callable[[], Any]) -> None:
    """Let a node whose robot has stopped hold itself, plan and read the outcome."""
    has_joint, command = node.has_joint, node.executive.motor_command
    node.executive = SimpleNamespace(
        finished=True, stopped="RF has slid 60 mm off its foothold", motor_command=command,
        step=lambda *readings: None, replan=replan,
    )  # fmt: skip
    names = list(node.place)
    zeros = [0.0] * int(has_joint.sum())
    node.hear(SimpleNamespace(name=names, position=zeros, effort=zeros))
    for _ in range(498):
        node.tick()
    assert node.planning is None  # it is at rest first
    for _ in range(4):
        node.tick()
    wait([node.planning] if node.planning is not None else [])
    node.tick()


def test_the_node_of_ros_2_goes_on_by_a_plan_from_where_it_stands(node: Any) -> None:
    following = SimpleNamespace(
        finished=False, stopped="", motor_command=np.ones_like(node.angles), step=lambda *_: None
    )
    _let_node_stop(node, lambda: following)
    assert node.executive is following
    assert node.notes == ["goes on by a plan from where it stands"]
    node.tick()
    np.testing.assert_array_equal(node.sent[-1], 1.0)


def test_the_node_of_ros_2_holds_itself_where_there_is_no_plan(node: Any) -> None:
    def replan() -> None:
        raise Unresolved("no plan from the measured stance", because="none was found")

    _let_node_stop(node, replan)
    assert "no plan from where it stands: no plan from the measured stance" in node.notes[0]
    sent = len(node.sent)
    for _ in range(600):
        node.tick()
    assert len(node.sent) == sent + 600  # it goes on to hold itself
    assert len(node.notes) == 1


def test_plans_timed_by_their_dynamics_are_refused(planned: Planned) -> None:
    plan = planned()
    torque = np.zeros_like(plan.trajectory.joint_command)
    fast = replace(plan, trajectory=replace(plan.trajectory, torque=torque))
    with pytest.raises(UsageError, match=r"timed by its dynamics \(trajectory\.pace\)"):
        ClimbExecutive(fast)


def test_settings_are_positive() -> None:
    with pytest.raises(UsageError, match="search_speed"):
        ExecutiveSettings(search_speed=0.0)


def test_events_are_described_in_words() -> None:
    names = ("RF", "LF")
    event = ExecutiveEvent(1.0, 1.0, "touched", 1, 0.012)
    assert describe_event(event, names) == "LF meets its surface 12 mm behind its place"
    assert describe_event(event._replace(kind="stopped", limb=-1), names) == "the robot stops"


def test_robots_that_stop_before_their_goal_do_not_fall(planned: Planned) -> None:
    arrived = ScenarioOutcome(False, 9.0, "", -1, -1, 0.01)
    stopped = replace(arrived, time=3.0, stopped="RF finds no surface within 30 mm")
    layout = build_layout(planned(), Uncertainty())
    risk = RiskEstimate("mujoco", 0, layout, (arrived, stopped, arrived))
    assert (risk.falls, risk.stops) == (0, 1)
    assert risk.stands == "stands in 3 of 3 worlds, stops before its goal in 1"
    assert "  1 of 3 worlds stop before the goal and stand" in format_risk(risk, (), planned())


@pytest.mark.merge
def test_a_climb_in_closed_loop_arrives_on_a_wall_that_is_farther(planned: Planned) -> None:
    plan = planned()
    surface = np.zeros(len(plan.terrain.surfaces))
    surface[plan.rounds.region[-1, 0]] = -0.02
    world = replace(build_nominal_world(plan), surface=surface)
    run = simulate(plan, Conditions(closed_loop=True, world=world))
    assert not run.fallen
    assert run.execution is not None
    assert run.execution.stopped == ""
    assert run.samples == len(plan.trajectory.time)
    assert run.execution.duration > plan.trajectory.time[-1]
    touched = [event.limb for event in run.execution.events if event.kind == "touched"]
    assert sorted(touched) == list(range(plan.robot.limb_count))


@pytest.mark.merge
def test_a_climb_in_closed_loop_is_the_same_again(planned: Planned) -> None:
    plan, conditions = planned(), Conditions(closed_loop=True, noise_seed=5)
    first, again = simulate(plan, conditions), simulate(plan, conditions)
    assert first.execution is not None
    assert again.execution is not None
    assert first.execution.events == again.execution.events
    np.testing.assert_array_equal(first.com, again.com)


@pytest.mark.merge
def test_a_climb_goes_on_by_another_plan_after_a_toe_has_slid(planned: Planned) -> None:
    plan = planned()
    slide = Conditions(closed_loop=True, losses=(FrictionLoss(1, 5.0, 0.15),))
    run, held = simulate(plan, slide), simulate(plan, replace(slide, max_replans=0))
    assert run.execution is not None
    assert held.execution is not None
    assert not run.fallen
    assert run.execution.stopped == ""
    (replan,) = run.execution.replans
    assert replan.reason == held.execution.stopped
    assert "off its foothold" in replan.reason
    assert run.execution.duration == pytest.approx(held.execution.duration + replan.duration)
    np.testing.assert_array_equal(run.com, held.com)
    assert run.execution.events[: len(held.execution.events)] == held.execution.events
    times = [event.time for event in run.execution.events]
    assert times == sorted(times)
    again = simulate(plan, slide)
    assert again.execution is not None
    assert again.execution.events == run.execution.events
