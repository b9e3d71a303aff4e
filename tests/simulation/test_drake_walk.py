"""A walk of A1 in Drake, from its exported table alone, by a controller of some fifty lines.

Nothing of the planner or of our simulators is used: the robot is its URDF, the floor a box, and all
that the controller knows is what `climbplan export --format csv` wrote.
"""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from a1_specs import WALK, a1_urdf, written

from climbplan.arrays import Array
from climbplan.cli.app import run

RATE, STEP = 500, 0.002  # [Hz] of the table, [s] between torques
LEAST_SHARE, MOST_SHARE = 0.98, 1.02  # of the planned distance
MOST_OFF = 0.02  # [m] of the base from its path
# Feedback of the base's pose along world axes: proportional and derivative gains
POSITION_GAIN = np.array([2400.0, 1200.0, 2000.0])  # [N/m]
VELOCITY_GAIN = np.array([400.0, 240.0, 300.0])  # [N s/m]
ATTITUDE_GAIN = np.array([90.0, 90.0, 45.0])  # [N m/rad]
RATE_GAIN = np.array([6.0, 6.0, 4.5])  # [N m s/rad]
SHARE_OF_GAIN, SHARE_OF_DAMPING = 0.5, 0.25  # at the joints, as torques are fed forward


class Table:
    """An exported motion by its documented columns."""

    def __init__(self, path: Path) -> None:
        self.facts = json.loads(path.with_suffix(".csv.json").read_text())
        with path.open() as stream:
            names = next(csv.reader(stream))
            self.rows = np.loadtxt(stream, delimiter=",")
        self.place = {name: index for index, name in enumerate(names)}
        self.joints = [joint["name"] for joint in self.facts["joints"]]
        self.contacts = self.facts["contacts"]

    def __call__(self, time: float, *names: str, held: bool = False) -> Array:
        """Columns at a time, straight from sample to sample, or held as the last one has them."""
        k = int(
            np.clip(np.searchsorted(self.rows[:, 0], time, side="right"), 1, len(self.rows) - 1)
        )
        (before, after), columns = self.rows[k - 1 : k + 1], [self.place[name] for name in names]
        share = 0.0 if held else (time - before[0]) / (after[0] - before[0])
        return np.asarray(((1 - share) * before + share * after)[columns])

    def of_joints(self, time: float, quantity: str, held: bool = False) -> Array:
        return self(time, *(f"{joint}_{quantity}" for joint in self.joints), held=held)


@dataclass
class World:
    """A1 on a floor, in Drake."""

    table: Table
    plant: Any
    diagram: Any

    @classmethod
    def of(cls, table: Table, urdf: Path) -> World:
        drake = pytest.importorskip("pydrake.all")
        builder = drake.DiagramBuilder()
        config = drake.MultibodyPlantConfig(
            time_step=0.001, discrete_contact_approximation="lagged"
        )
        plant, scene = drake.AddMultibodyPlant(config, builder)
        seen = re.sub(r"<visual>.*?</visual>", "", urdf.read_text(), flags=re.DOTALL)
        (model,) = drake.Parser(plant).AddModelsFromString(seen, "urdf")
        bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model)]
        own = [g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)]
        apart = drake.CollisionFilterDeclaration().ExcludeWithin(drake.GeometrySet(own))
        scene.collision_filter_manager().Apply(apart)
        below, floor = drake.RigidTransform([0, 0, -0.5]), drake.Box(20, 20, 1)
        friction = drake.CoulombFriction(0.8, 0.8)
        plant.RegisterCollisionGeometry(plant.world_body(), below, floor, "floor", friction)
        for joint in table.facts["joints"]:
            place = plant.GetJointByName(joint["name"])
            plant.AddJointActuator(joint["name"], place, joint["max_torque"])
        plant.Finalize()
        return cls(table, plant, builder.Build())

    def walk(self) -> Array:
        """Play the table; how far (T, 3) the base is off its path at each step [m]."""
        drake = pytest.importorskip("pydrake.all")
        table, plant = self.table, self.plant
        root = self.diagram.CreateDefaultContext()
        context = plant.GetMyMutableContextFromRoot(root)
        base = plant.GetBodyByName(table.facts["base_link"])
        joints = [plant.GetJointByName(name) for name in table.joints]
        moved = [joint.velocity_start() for joint in joints]
        facts = table.facts["joints"]
        gain = SHARE_OF_GAIN * np.array([joint["gain_rigid"] for joint in facts])
        damping = SHARE_OF_DAMPING * np.array([joint["damping"] for joint in facts])
        limit = np.array([joint["max_torque"] for joint in facts])

        def place(time: float) -> Array:
            return table(time, "base_x_m", "base_y_m", "base_z_m")

        def turn(time: float) -> Any:
            w, *rest = table(time, "base_qw", "base_qx", "base_qy", "base_qz")
            unit = np.array([w, *rest]) / np.linalg.norm([w, *rest])
            return drake.RotationMatrix(drake.Quaternion(unit))

        def speed(time: float) -> Array:
            ahead = min(time + 0.01, end)
            return (place(ahead) - place(ahead - 0.01)) / 0.01

        end, off = float(table.rows[-1, 0]), []
        plant.SetFreeBodyPose(context, base, drake.RigidTransform(turn(0.0), place(0.0)))
        start = drake.SpatialVelocity(np.zeros(3), speed(0.0))
        plant.SetFreeBodySpatialVelocity(context, base, start)
        for joint, angle in zip(joints, table.of_joints(0.0, "angle_rad"), strict=True):
            joint.set_angle(context, angle)
        simulator = drake.Simulator(self.diagram, root)
        for step in range(round(end / STEP)):
            now = step * STEP
            pose, velocity = base.EvalPoseInWorld(context), base.EvalSpatialVelocityInWorld(context)
            missing = place(now) - pose.translation()
            axis = turn(now).multiply(pose.rotation().inverse()).ToAngleAxis()
            pull = POSITION_GAIN * missing + VELOCITY_GAIN * (speed(now) - velocity.translational())
            twist = ATTITUDE_GAIN * axis.angle() * axis.axis() - RATE_GAIN * velocity.rotational()
            grasp, jacobians = [np.zeros((6, 0))], [np.zeros((0, len(joints)))]
            for contact in table.contacts:
                if table(now, f"{contact['name']}_contact", held=True)[0] > 0.5:
                    frame, offset = plant.GetFrameByName(contact["link"]), contact["offset"]
                    point = frame.CalcPoseInWorld(context).multiply(np.array(offset))
                    x, y, z = point - pose.translation()
                    grasp.append(np.vstack([np.eye(3), [[0, -z, y], [z, 0, -x], [-y, x, 0]]]))
                    kind, world = drake.JacobianWrtVariable.kV, plant.world_frame()
                    jacobian = plant.CalcJacobianTranslationalVelocity(
                        context, kind, frame, offset, world, world
                    )
                    jacobians.append(jacobian[:, moved])
            grasp_map = np.hstack(grasp)
            wrench = np.concatenate([pull, twist])
            force = grasp_map.T @ np.linalg.solve(
                grasp_map @ grasp_map.T + 1e-3 * np.eye(6), wrench
            )
            angles = np.array([joint.get_angle(context) for joint in joints])
            rates = np.array([joint.get_angular_rate(context) for joint in joints])
            torque = table.of_joints(now, "torque_Nm", held=True)
            torque = torque + table.of_joints(now, "gravity_Nm") - np.vstack(jacobians).T @ force
            torque += gain * (table.of_joints(now, "angle_rad") - angles)
            torque += damping * (table.of_joints(now, "velocity_rad_s") - rates)
            plant.get_actuation_input_port().FixValue(context, np.clip(torque, -limit, limit))
            simulator.AdvanceTo(now + STEP)
            off.append(missing)
        return np.array(off)


def test_a1_walks_as_its_table_says(tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    spec, plan, table = written(tmp_path, WALK), tmp_path / "plan", tmp_path / "walk.csv"
    assert run(["plan-mpc", str(spec), "-o", str(plan), "--no-report"]) == 0
    assert run(["export", str(plan), "--rate", str(RATE), "-o", str(table)]) == 0
    motion = Table(table)
    off = World.of(motion, a1_urdf()).walk()
    planned = motion.rows[:, motion.place["base_x_m"]]
    distance = planned[-1] - planned[0]
    share = (distance - off[-1, 0]) / distance
    assert distance > 0.8
    assert LEAST_SHARE < share < MOST_SHARE
    assert np.linalg.norm(off, axis=1).max() < MOST_OFF
