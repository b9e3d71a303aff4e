"""What is exported, read from disk as a robot reads it, holds the climb in MuJoCo.

The machine here is no part of climbplan but its model of robot and terrain: motors are torque
sources or servos, encoders sit before what the structure gives, and nobody tells the controller
where the body is.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

import climbplan
from climbplan.arrays import Array
from climbplan.cli.app import run
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.simulation.initial_posture import place_robot
from climbplan.climb.simulation.model.chain_limb import name_motors
from climbplan.climb.simulation.model.mjcf import TIME_STEP, build_mjcf
from climbplan.climb.simulation.replay import RecordedRun, simulate
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.motors import compute_rotor_inertia

SPECS = Path(__file__).parents[2] / "specs"
SETTLE = 1.0  # [s] at the first commands
Controller = Callable[[float, Array], Array]  # time [s], (N, J) encoder angles [rad]


class Machine:
    """A robot on its terrain: what its motors are told, what its encoders read."""

    def __init__(self, plan: ClimbPlan) -> None:
        self.mujoco = pytest.importorskip("mujoco")
        self.plan = plan
        robot, n = plan.robot, plan.robot.limb_count
        self.model = self.mujoco.MjModel.from_xml_string(build_mjcf(plan, Conditions()))
        self.data = self.mujoco.MjData(self.model)
        self.names = [name for limb in range(n) for name in name_motors(robot, limb)]
        joints = [self.model.joint(name) for name in self.names]
        self.position = np.array([joint.qposadr[0] for joint in joints])
        self.velocity = np.array([joint.dofadr[0] for joint in joints])
        self.toes = np.array([self.model.geom(f"toe{limb}").id for limb in range(n)])
        self.shape = (n, robot.joint_count)
        # All that a limb gives for what its motor alone does
        self.give = np.broadcast_to(joint_softness(robot) * robot.joint_stiffness, self.shape)
        start = place_robot(plan, plan.terrain)
        self.data.qpos[:3] = plan.rounds.com[0]
        turned = np.empty(4)
        self.mujoco.mju_mat2Quat(turned, rotation_world_body(plan.rounds.rpy[0]).ravel())
        self.data.qpos[3:7] = turned
        self.data.qpos[self.position] = start.angles.ravel()
        self.mujoco.mj_forward(self.model, self.data)

    def angles(self) -> Array:
        """(N, J) of the links [rad]."""
        return np.asarray(self.data.qpos[self.position].reshape(self.shape))

    def servos(self, controller: Controller, period: float = 0.01) -> None:
        """Run with the model's own position servos, told anew after each period."""
        told = controller(0.0, self.angles())
        self.data.ctrl[:] = told.ravel()
        self.mujoco.mj_step(self.model, self.data, nstep=round(SETTLE / TIME_STEP))
        steps = round(period / TIME_STEP)
        for k in range(1, round(self.plan.trajectory.time[-1] / period) + 1):
            # Servos are as soft as motor and structure in series; the encoder sees the motor's part
            seen = told + (self.angles() - told) / self.give
            told = controller(k * period, seen).copy()
            self.data.ctrl[:] = told.ravel()
            self.mujoco.mj_step(self.model, self.data, nstep=steps)

    def torques(
        self, p: Array, goal: Callable[[float], Array], effort: Callable[[float], Array]
    ) -> None:
        """Run with p (command - encoder) - d velocity + effort as torques; p, d: (N, J)."""
        self.model.actuator_gainprm[:] = 0.0
        self.model.actuator_gainprm[:, 0] = 1.0
        self.model.actuator_biasprm[:] = 0.0
        self.model.actuator_biastype[:] = 0
        self.model.actuator_ctrllimited[:] = 0
        robot = self.plan.robot
        structure = joint_softness(robot) - 1 / robot.joint_stiffness  # [rad/(N m)]
        behind = 1 + (p * structure).ravel()
        p = p.ravel()
        d = 2 * np.sqrt(
            p / behind * compute_rotor_inertia(robot, NOMINAL).ravel()
        )  # what such motors need
        for k in range(round((SETTLE + self.plan.trajectory.time[-1]) / TIME_STEP)):
            time = max(k * TIME_STEP - SETTLE, 0.0)
            link = self.data.qpos[self.position]
            # The encoder stands off the link by what the structure gives under the torque
            pull = (p * (goal(time) - link) + effort(time)) / behind
            self.data.ctrl[:] = pull - d * self.data.qvel[self.velocity]
            self.mujoco.mj_step(self.model, self.data)

    def departures(self, other: RecordedRun) -> tuple[float, float]:
        """How far body and toes stand from where they do at the end of a run [m]."""
        assert not other.fallen
        body = np.linalg.norm(self.data.qpos[:3] - other.com[-1])
        toes = np.linalg.norm(self.data.geom_xpos[self.toes] - other.toes[-1], axis=1)
        return float(body), float(toes.max())

    def off(self) -> float:
        """How far the body is from where the plan ends [m]."""
        return float(np.linalg.norm(self.data.qpos[:3] - self.plan.rounds.com[-1]))


def alone(path: Path) -> ModuleType:
    """The exported code as a module of its own, not climbplan's."""
    spec = importlib.util.spec_from_file_location("regulator_of_a_robot", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[spec.name]
    return module


def regulated(plan_file: Path, place: Path) -> Machine:
    """The climb under the exported regulator."""
    assert run(["export", str(plan_file), "--format", "regulator", "-o", str(place), "-q"]) == 0
    robots = alone(place / "joint_regulator.py")
    assert Path(robots.__file__ or "") == place / "joint_regulator.py"
    regulator = robots.JointRegulator(robots.read_tables(place / "regulator.npz"))
    machine = Machine(read_climb(plan_file))
    machine.servos(regulator.tick)
    return machine


def under_pd(plan_file: Path, place: Path, *more: str, told: float | None = None) -> Machine:
    """The climb under a PD controller that knows the two files of a trajectory controller.

    told: P gain that somebody sets instead of the stated ones [N m/rad].
    """
    asked = ["export", str(plan_file), "--format", "jtc", "-o", str(place), "-q", *more]
    asked += ["--ramp", "0"]
    assert run(asked) == 0
    own: Any = yaml.safe_load((place / "controllers.yaml").read_text(encoding="utf-8"))
    gains = own["joint_trajectory_controller"]["ros__parameters"]["gains"]
    goal = yaml.load(
        (place / "goal.yaml").read_text(encoding="utf-8"),
        Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader),
    )["trajectory"]
    plan = read_climb(plan_file)
    names = list(plan.robot.motor_names)
    assert goal["joint_names"] == names
    points = goal["points"]
    at = np.array(
        [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    )
    commands = np.array([p["positions"] for p in points])
    efforts = np.array([p.get("effort", [0.0] * len(names)) for p in points])

    def between(rows: Array) -> Callable[[float], Array]:
        def value(time: float) -> Array:
            k = min(int(np.searchsorted(at, time, side="right")), len(at) - 1)
            share = np.clip((time - at[k - 1]) / (at[k] - at[k - 1]), 0.0, 1.0)
            return np.asarray((1 - share) * rows[k - 1] + share * rows[k])

        return value

    machine = Machine(plan)
    p = np.array([gains[name]["p"] for name in names]).reshape(machine.shape)
    if told is not None:
        p[:] = told
    machine.torques(p, between(commands), between(efforts))
    return machine


def test_the_exported_regulator_holds_a_short_climb(plans: dict[str, Path], tmp_path: Path) -> None:
    """As the same code does within `simulate`: the body to a tenth of a millimetre."""
    machine = regulated(plans["climb"], tmp_path / "regulator")
    body, toes = machine.departures(simulate(machine.plan, Conditions(regulator="joints")))
    assert body < 3e-4
    assert toes < 3e-3
    assert machine.off() < 2e-3


@pytest.mark.slow
def test_a_pd_controller_with_the_stated_gains_holds_a_short_climb(
    plans: dict[str, Path], tmp_path: Path
) -> None:
    machine = under_pd(plans["climb"], tmp_path / "jtc")
    body, toes = machine.departures(simulate(machine.plan, Conditions()))
    assert max(body, toes) < 3e-3
    assert machine.off() < 5e-3
    other = under_pd(plans["climb"], tmp_path / "other", "--gains", "150")
    assert other.off() < 5e-3
    wrong = under_pd(plans["climb"], tmp_path / "wrong", told=30.0)
    assert wrong.off() > 2 * machine.off()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["climb_steps", "transition_flat"])
def test_scenes_stand_by_their_files_as_they_do_in_simulate(name: str, tmp_path: Path) -> None:
    """Four minutes over steps, and onto the walls: both files, no fall, toes in place."""
    path = tmp_path / "plan.h5"
    climbplan.plan(SPECS / f"{name}.yaml").save(path)
    machine = regulated(path, tmp_path / "regulator")
    body, toes = machine.departures(simulate(machine.plan, Conditions(regulator="joints")))
    assert max(body, toes) < 4e-3
    assert machine.off() < 5e-3
    machine = under_pd(path, tmp_path / "jtc")
    body, toes = machine.departures(simulate(machine.plan, Conditions()))
    # Without a regulator toes creep for four minutes, in each run on a way of their own
    assert max(body, toes) < 10e-3
    assert machine.off() < 10e-3
