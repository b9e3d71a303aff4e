"""From exported files and a plan's terrain to a report: one run in Drake."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml

from climbplan.errors import UsageError
from climbplan.simulation.drake.comparison import compare
from climbplan.simulation.drake.controller import (
    REGULATOR,
    Controller,
    FileController,
    RegulatedController,
)
from climbplan.simulation.drake.exported import ExportedMotion, read_motion
from climbplan.simulation.drake.planned_penetration import find_planned_penetrations
from climbplan.simulation.drake.plant import Plant, build_plant, import_pydrake
from climbplan.simulation.drake.playing import play
from climbplan.simulation.drake.report import ReportedRun
from climbplan.simulation.drake.robot_document import write_robot_document
from climbplan.simulation.drake.settings import Settings
from climbplan.simulation.drake.terrain import read_terrain

SAMPLES = 100  # postures that are compared, at most


def compute_gravity_difference(plant: Plant, root: Any, motion: ExportedMotion) -> float:
    """Return the largest difference, as a fraction of the motors' torque limits.

    The robot is at the plan's first sample afterwards.
    """
    context = plant.plant.GetMyMutableContextFromRoot(root)
    limits = np.array([joint.max_torque for joint in motion.joints])
    velocities = [joint.velocity_start() for joint in plant.joints]
    largest = 0.0
    count = min(SAMPLES, len(motion.time))
    for sample in np.linspace(0, len(motion.time) - 1, count).round().astype(int):
        plant.place(context, motion, int(sample))
        bearing = -plant.plant.CalcGravityGeneralizedForces(context)[velocities]
        difference = np.abs(bearing - motion.gravity[sample]) / limits
        largest = max(largest, float(difference.max()))
    plant.place(context, motion, 0)
    return largest


@dataclass(frozen=True)
class StoredUrdf:
    """A robot's URDF as its plan carries it."""

    text: str
    path: Path  # that the robot file names
    packages: dict[str, str]  # package -> directory, of meshes
    mass: float  # of the planned robot [kg]
    gravity: float  # [m/s^2]


def read_stored_urdf(plan: Path) -> StoredUrdf:
    """Read the URDF of a plan.

    Raises UsageError for a plan of a robot that is not from a URDF.
    """
    with h5py.File(plan, "r") as file:
        robot = file["robot"].attrs
        text = str(robot.get("urdf", ""))
        if not text or "<robot" not in text:
            raise UsageError(
                f"--engine drake: {robot['name']} is not from a URDF; the second engine plays a "
                "plan on the robot's own URDF, so plan it with a robot file that has `urdf:`"
            )
        spec = yaml.safe_load(str(file.attrs["spec"]))
        source = str(robot.get("source", ""))
        section = yaml.safe_load(source) if source else spec["robot"]
        mass, gravity = float(robot["mass"]), float(robot["gravity"])
    packages = {str(k): str(v) for k, v in (section.get("packages") or {}).items()}
    return StoredUrdf(text, Path(section["urdf"]), packages, mass, gravity)


def simulate_exported(
    directory: Path,
    plan: Path,
    settings: Settings,
    urdf: Path | None,
    progress: Callable[[float], None],
) -> ReportedRun:
    """Play the exported files of a directory in Drake.

    Args:
        directory: with `motion.csv`, `motion.csv.json` and, where it is regulated,
            `regulator.npz`.
        plan: the plan file, for the terrain and the text of the URDF.
        settings: what of the world differs from the plan.
        urdf: the robot's file, which relative names of meshes start from; where the robot file
            names it if None.
        progress: called with the fraction done.

    Raises:
        MissingSolver: Drake is not installed.
        UsageError: the robot is not from a URDF, or a mesh of it is not found.
    """
    version = str(import_pydrake("common").__dict__.get("__version__", "")) or _read_version()
    stored = read_stored_urdf(plan)
    motion = read_motion(directory)
    solids, left_out = read_terrain(plan)
    controller: Controller = FileController(motion)
    if settings.regulate:
        controller = RegulatedController(motion, directory / REGULATOR)
    with tempfile.TemporaryDirectory(prefix="climbplan-") as temporary:
        document = write_robot_document(
            stored.text, urdf or stored.path, stored.packages, Path(temporary)
        )
        plant = build_plant(motion, document, solids, stored.gravity, settings)
        root = plant.create_context(motion, stored.mass)
        ignored = plant.ignore_overlaps(root)
        penetrations = find_planned_penetrations(plant, root, motion)
        weights = compute_gravity_difference(plant, root, motion)
        recording, contacts = play(plant, root, motion, controller, settings, progress)
    compared = compare(recording, motion, stored.mass * stored.gravity)
    return ReportedRun(
        motion,
        plant,
        settings,
        recording,
        contacts,
        compared,
        penetrations,
        weights,
        ignored,
        left_out,
        stored.mass,
        version,
    )


def _read_version() -> str:
    from importlib.metadata import version

    return version("drake")
