"""An exported motion played in Drake, step by step."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.simulation.drake.contacts import ContactLog
from climbplan.simulation.drake.controller import Controller, interpolate
from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.plant import Plant, import_pydrake
from climbplan.simulation.drake.settings import Settings

FALLEN = 0.15  # [m] of the base from its planned place
TUMBLED = np.deg2rad(45)  # from its planned attitude
SAMPLE_PERIOD = 0.05  # [s] between recorded samples


@dataclass
class Recording:
    """What happened, S samples."""

    time: list[float] = field(default_factory=list)  # [s]
    departure: list[Array] = field(default_factory=list)  # (3,) of the base from its plan [m]
    turned: list[float] = field(default_factory=list)  # from its planned attitude [rad]
    torque: list[Array] = field(default_factory=list)  # (J,) of motors [N m]
    force: list[Array] = field(default_factory=list)  # (C, 3) at toes, on the robot [N]
    fall_time: float | None = None  # [s]
    fall_words: str = ""
    cpu_seconds: float = 0.0


def play(
    plant: Plant,
    root: Any,
    motion: ExportedMotion,
    controller: Controller,
    settings: Settings,
    progress: Callable[[float], None],
) -> tuple[Recording, ContactLog]:
    """Play a motion from a context to its end, or until the robot has fallen.

    progress: called with the fraction done, from time to time.
    """
    system, recording = plant.plant, Recording()
    contacts = ContactLog(plant, motion)
    context = system.GetMyMutableContextFromRoot(root)
    simulator = import_pydrake("systems.analysis").Simulator(plant.diagram, root)
    positions = [joint.position_start() for joint in plant.joints]
    state_port = system.get_desired_state_input_port(plant.model)
    torque_port = system.get_actuation_input_port(plant.model)
    net_torque = system.get_net_actuation_output_port(plant.model)
    zero_velocity = np.zeros(len(positions))
    begin, end = float(motion.time[0]), float(motion.time[-1])
    steps = int(np.ceil((end - begin) / settings.control_period - 1e-9))
    sampled = max(1, round(SAMPLE_PERIOD / settings.control_period))
    started = clock.process_time()
    for step in range(steps):
        now = begin + step * settings.control_period
        angles = system.GetPositions(context)[positions]
        command = controller.command(now, angles)
        added = interpolate(motion.time, motion.effort + motion.gravity, now)
        state_port.FixValue(context, np.concatenate([command, zero_velocity]))
        torque_port.FixValue(context, added)
        try:
            simulator.AdvanceTo((step + 1) * settings.control_period)
        except RuntimeError as error:  # Drake has no exception of its own
            recording.fall_time, recording.fall_words = now, f"Drake finds no step: {error}"
            break
        after = min(now + settings.control_period, end)
        contacts.update(context, after, settings.control_period)
        if (step + 1) % sampled == 0 or step + 1 == steps:
            _record(recording, plant, context, motion, after)
            recording.torque.append(net_torque.Eval(context).copy())
            recording.force.append(contacts.force.copy())
            progress((step + 1) / steps)
            away, tilt = np.linalg.norm(recording.departure[-1]), recording.turned[-1]
            if away > FALLEN or tilt > TUMBLED:
                recording.fall_time = after
                recording.fall_words = (
                    f"{1e3 * away:.0f} mm and {np.rad2deg(tilt):.0f} degrees off its plan"
                )
                break
    contacts.finish(recording.time[-1] if recording.time else begin)
    recording.cpu_seconds = clock.process_time() - started
    return recording, contacts


def _record(
    recording: Recording, plant: Plant, context: Any, motion: ExportedMotion, time: float
) -> None:
    """Add where the base is beside where it should be."""
    pose = plant.base.EvalPoseInWorld(context)
    planned = interpolate(motion.time, motion.base_position, time)
    x, y, z, w = interpolate(motion.time, motion.base_quaternion, time)
    unit = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    turn = import_pydrake("common.eigen_geometry").Quaternion(unit)
    planned_turn = import_pydrake("math").RotationMatrix(turn)
    between = planned_turn.inverse().multiply(pose.rotation())
    recording.time.append(time)
    recording.departure.append(pose.translation() - planned)
    recording.turned.append(abs(between.ToAngleAxis().angle()))
