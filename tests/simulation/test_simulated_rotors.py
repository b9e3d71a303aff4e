"""Rotors, derivative gains and friction of simulated robots are their data, scaled at will."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.cli.simulate_options import ScaleOrValue, parse_scale
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.simulation.implicit_dynamics.engine import build_robot, prepare_steps
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.errors import PlanFileError, UsageError
from climbplan.robots.model import dynamics_of
from climbplan.simulation.conditions import NOMINAL, Conditions
from climbplan.simulation.motors import (
    compute_joint_damping,
    compute_motor_damping,
    compute_rotor_inertia,
)

mujoco = pytest.importorskip("mujoco")


@pytest.fixture(scope="module", name="plan")
def _plan(planned: Callable[..., ClimbPlan]) -> ClimbPlan:
    plan = planned()
    own = dynamics_of(plan.robot)
    rough = replace(own, viscous_friction=own.damping / 10, dry_friction=own.damping / 100)
    return replace(plan, robot=replace(plan.robot, dynamics=rough))


def compiled(plan: ClimbPlan, conditions: Conditions) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(build_mjcf(plan, conditions))


def test_the_model_has_the_robots_own(plan: ClimbPlan) -> None:
    own, model = dynamics_of(plan.robot), compiled(plan, NOMINAL)
    assert model.dof_armature[6:].reshape(6, 3) == pytest.approx(own.rotor_inertia)
    assert model.dof_damping[6:].reshape(6, 3) == pytest.approx(own.viscous_friction)
    assert model.dof_frictionloss[6:].reshape(6, 3) == pytest.approx(own.dry_friction)
    gains = -np.asarray(model.actuator_biasprm)[:, 2].reshape(6, 3)
    assert gains == pytest.approx(own.damping)


def test_another_armature_leaves_the_controllers_gains(plan: ClimbPlan) -> None:
    own, half = dynamics_of(plan.robot), Conditions(armature=0.5)
    assert compute_rotor_inertia(plan.robot, half) == pytest.approx(own.rotor_inertia / 2)
    assert compute_motor_damping(plan.robot, half) == pytest.approx(own.damping)
    stated = Conditions(armature_value=0.003)
    assert compiled(plan, stated).dof_armature[6:] == pytest.approx(0.003)


def test_damping_scales_gains_and_viscous_friction(plan: ClimbPlan) -> None:
    own = dynamics_of(plan.robot)
    twice = compute_joint_damping(plan.robot, Conditions(damping=2.0))
    assert twice == pytest.approx(2 * (own.damping + own.viscous_friction))
    stated = compute_joint_damping(plan.robot, Conditions(damping_value=1.0))
    assert stated == pytest.approx(1.0 + own.viscous_friction)


def test_quasi_static_steps_have_the_same(plan: ClimbPlan) -> None:
    conditions = Conditions(armature=0.5, damping=2.0)
    machine = build_robot(plan, plan.terrain, prepare_steps(plan, conditions), conditions)
    assert machine.armature == pytest.approx(compute_rotor_inertia(plan.robot, conditions))
    assert machine.damping == pytest.approx(compute_joint_damping(plan.robot, conditions))


def test_plan_files_keep_them_and_those_without_are_read(plan: ClimbPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    kept = read_climb(path).robot.dynamics
    assert kept is not None
    for name, values in vars(dynamics_of(plan.robot)).items():
        assert np.array_equal(vars(kept)[name], values)
    with h5py.File(path, "r+") as file:
        assert file["robot/joint_dynamics/rotor_inertia"].attrs["units"] == "kg m^2"
        del file["robot/joint_dynamics"]
    old = read_climb(path).robot
    assert old.dynamics is None
    assert dynamics_of(old).rotor_inertia == pytest.approx(0.006 * 25 / 4.7)


def test_rotors_without_inertia_are_refused(plan: ClimbPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    with h5py.File(path, "r+") as file:
        file["robot/joint_dynamics/rotor_inertia"][0, 0] = 0.0
    with pytest.raises(PlanFileError, match=re.escape("rotor_inertia: expected > 0, got 0")):
        read_climb(path)


def test_a_command_line_gives_a_factor_or_a_value() -> None:
    assert parse_scale("--armature", "0.5") == ScaleOrValue(factor=0.5)
    assert parse_scale("--armature", "=0.003") == ScaleOrValue(value=0.003)
    for text in ("-1", "=", "twice", "nan", "=-0.1"):
        with pytest.raises(UsageError, match=f"--damping {text}: expected a factor"):
            parse_scale("--damping", text)
