"""MPC plans as HDF5 files: writing them, and reading them back exactly."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np

import climbplan
from climbplan.errors import PlanFileError
from climbplan.mpc.answer import Improvement
from climbplan.mpc.ground import Ground
from climbplan.mpc.plan import STATUSES, LoopRecord, WalkPlan
from climbplan.mpc.task import (
    ANGLES,
    LEGS,
    POSITION,
    SPIN,
    VELOCITY,
    Gait,
    Integrator,
    Reference,
    RigidBody,
    Start,
    WalkTask,
    WalkTrajectory,
    Weights,
)
from climbplan.plans.hdf5_layout import Layout
from climbplan.plans.hdf5_reading import Reader, opened_store
from climbplan.plans.hdf5_writing import new_store, write_dataset, write_json, write_text

FORMAT = "climbplan/mpc"
FORMAT_VERSION = 1

# T samples, S regions, H improvements; legs in the order of robot/leg_names
SAMPLES = {
    "time": Layout(("T",), "s"),
    "com": Layout(("T", 3), "m", "world"),
    "velocity": Layout(("T", 3), "m/s", "world"),
    "euler_zyx": Layout(("T", 3), "rad", "roll, pitch, yaw of R = Rz Ry Rx, body to world"),
    "angular_velocity": Layout(("T", 3), "rad/s", "world"),
    "toes": Layout(("T", LEGS, 3), "m", "world"),
    "contact": Layout(("T", LEGS), kind="bool"),
    "region": Layout(("T", LEGS), kind="int"),
    "force": Layout(("T", LEGS, 3), "N", "world, on the robot"),
    "reference/velocity": Layout(("T", 3), "m/s", "world"),
    "reference/euler_zyx": Layout(("T", 3), "rad", "roll, pitch, yaw"),
    "reference/height": Layout(("T",), "m", "world"),
}
ROBOT = {
    "inertia": Layout((3, 3), "kg m^2", "body"),
    "toe_center": Layout((LEGS, 3), "m", "body"),
    "toe_half": Layout((3,), "m", "body"),
    "leg_names": Layout((LEGS,), kind="text"),
}
GROUND = {
    "lower": Layout(("S", 2), "m", "world"),
    "upper": Layout(("S", 2), "m", "world"),
    "height": Layout(("S",), "m", "world"),
    "names": Layout(("S",), kind="text"),
}
START = {
    "state": Layout((12,), "m, m/s, rad, rad/s", "world"),
    "toes": Layout((LEGS, 3), "m", "world"),
}
HISTORY = {
    "seconds": Layout(("H",), "s"),
    "objective": Layout(("H",), "", may_be_infinite=True),
    "bound": Layout(("H",), "", may_be_infinite=True),
}
LOOP = {
    "push": Layout(("T", 3), "m/s", "world"),
    "tick_time": Layout(("T",), "s"),
    "solve_time": Layout(("T",), "s"),
    "candidates_tried": Layout(("T",), kind="int"),
    "winner": Layout(("T",), kind="int"),
}
_TEXTS = Layout(("*",), kind="text")
_NOTES = {
    "axes": "body frame x forward, y left, z up; world frame z up",
    "force_is": "constant from sample n to n + 1; zeros at the last",
    "contact_is": "whether the leg stands from sample n to n + 1",
    "reference_is": "of samples 1 to T - 1; that of sample 0 repeats sample 1",
}


def write_walk_plan(plan: WalkPlan, path: Path) -> None:
    """Write a plan; the file appears whole or not at all, in place of one that is there.

    An empty `created` or `climbplan_version` becomes now and this version. Raises UsageError if
    the file cannot be written.
    """
    plan = replace(
        plan,
        created=plan.created or datetime.now(UTC).isoformat(timespec="seconds"),
        climbplan_version=plan.climbplan_version or climbplan.__version__,
    )
    task, found = plan.task, plan.trajectory
    with new_store(path) as file:
        _write_header(file, plan)
        reference = task.reference
        samples = {
            "time": task.step * np.arange(task.knots + 1),
            "com": found.state[:, POSITION],
            "velocity": found.state[:, VELOCITY],
            "euler_zyx": found.state[:, ANGLES],
            "angular_velocity": found.state[:, SPIN],
            "toes": found.toes,
            "contact": found.gait.contact,
            "region": found.gait.region,
            "force": found.force,
            "reference/velocity": _repeated(reference.velocity),
            "reference/euler_zyx": _repeated(reference.euler),
            "reference/height": _repeated(reference.height),
        }
        for name, layout in SAMPLES.items():
            group, _, last = name.rpartition("/")
            write_dataset(file.require_group(group or "/"), last, samples[name], layout)
        _write_task(file, task)
        if plan.robot_text:
            write_text(file["robot"], "source", plan.robot_text)
        history = file.create_group("history")
        for name, layout in HISTORY.items():
            values = np.array([vars(step)[name] for step in plan.history], float)
            write_dataset(history, name, values, layout)
        if plan.loop is not None:
            for name, layout in LOOP.items():
                write_dataset(file, name, vars(plan.loop)[name], layout)
            write_dataset(file, "tick_warnings", plan.loop.warnings, _TEXTS)
        write_dataset(file, "warnings", plan.warnings, _TEXTS)
        write_dataset(file, "summary", plan.summary, _TEXTS)


def read_walk_plan(path: Path) -> WalkPlan:
    """The plan in a file, exactly as it was written.

    Raises PlanFileError for anything that is not a whole MPC plan.
    """
    plan = read_as_found(path)
    if plan.not_finite:
        raise PlanFileError(f"{path}: NaN or infinity in {', '.join(plan.not_finite)}")
    return plan


def read_as_found(path: Path) -> WalkPlan:
    """As `read_walk_plan`, but numbers that are not finite are only listed, for a check."""
    with opened_store(path) as file:
        reader = Reader(path, file)
        if not reader.has_attribute("", "format"):
            raise reader.refuse("HDF5, but not a climbplan file (no attribute `format`)")
        if (found := reader.text("", "format")) != FORMAT:
            raise reader.refuse(f"holds {found!r}, expected {FORMAT!r}")
        if (version := reader.integer("", "format_version")) != FORMAT_VERSION:
            newer = "; a newer climbplan reads it" if version > FORMAT_VERSION else ""
            raise reader.refuse(f"format version {version}, expected {FORMAT_VERSION}{newer}")
        return _read(reader)


def _repeated(values: Any) -> Any:
    """With the first row twice: there is no reference at sample 0."""
    return np.concatenate([values[:1], values])


def _write_header(file: h5py.File, plan: WalkPlan) -> None:
    texts = {
        "format": FORMAT,
        "climbplan_version": plan.climbplan_version,
        "created": plan.created,
        "name": plan.name,
        "title": plan.title,
        "spec": plan.spec_text,
        "spec_sha256": plan.spec_sha256,
        "status": plan.status,
        "method": plan.method,
        "integrator": plan.task.integrator,
        **_NOTES,
    }
    for name, text in texts.items():
        write_text(file, name, text)
    file.attrs["format_version"] = FORMAT_VERSION
    file.attrs["seed"] = plan.seed
    file.attrs["verified"] = np.bool_(plan.verified)
    file.attrs["objective"] = float(plan.objective)
    for name in ("bound", "gap"):
        if (value := vars(plan)[name]) is not None:
            file.attrs[name] = float(value)
    file.attrs["step"] = plan.task.step
    file.attrs["lift"] = plan.task.lift
    file.attrs["least_contacts"] = plan.task.least_contacts
    file.attrs["whole_stance"] = np.bool_(plan.task.whole_stance)
    for name in ("timings", "solvers", "sizes"):
        write_json(file, name, vars(plan)[name])
    write_json(file, "terms", dict(plan.terms))


def _write_task(file: h5py.File, task: WalkTask) -> None:
    body = task.body
    robot = file.create_group("robot")
    write_text(robot, "name", body.name)
    robot.attrs["mass"] = body.mass
    robot.attrs["gravity"] = body.gravity
    robot.attrs["friction"] = task.ground.friction
    robot.attrs["force_limit"] = body.force_limit
    robot.attrs["inertia"] = body.inertia
    for name, layout in ROBOT.items():
        write_dataset(robot, name, vars(body)[name], layout)
    ground = file.create_group("ground")
    for name, layout in GROUND.items():
        write_dataset(ground, name, vars(task.ground)[name], layout)
    start = file.create_group("start")
    for name, layout in START.items():
        write_dataset(start, name, vars(task.start)[name], layout)
    weights = file.create_group("weights")
    for name in ("velocity", "angles"):
        write_dataset(weights, name, vars(task.weights)[name], Layout((3,)))
    for name in ("height", "motion", "force_difference"):
        weights.attrs[name] = vars(task.weights)[name]


def _read(reader: Reader) -> WalkPlan:
    parts = {name: reader.array(name, layout) for name, layout in SAMPLES.items()}
    if len(parts["time"]) < 2:
        raise reader.refuse("time has fewer than two samples")
    task = _read_task(reader, parts)
    for name in ("state", "toes"):
        parts[f"start/{name}"] = reader.array(f"start/{name}", START[name])
    region = parts["region"]
    if region.size and not (region.min() >= 0 and region.max() < len(task.ground.height)):
        raise reader.refuse("region names a region that is not there")
    trajectory = WalkTrajectory(
        np.concatenate(
            [parts[name] for name in ("com", "velocity", "euler_zyx", "angular_velocity")], axis=1
        ),
        parts["toes"],
        parts["force"],
        Gait(parts["contact"], region),
    )
    history = {name: reader.array(f"history/{name}", layout) for name, layout in HISTORY.items()}
    status = reader.text("", "status")
    if status not in STATUSES:
        raise reader.refuse(f"status {status!r}, expected one of {', '.join(STATUSES)}")
    return WalkPlan(
        name=reader.text("", "name"),
        title=reader.text("", "title"),
        method=reader.text("", "method"),
        status=status,
        task=task,
        trajectory=trajectory,
        objective=reader.number("", "objective"),
        terms=_mapping(reader, "terms"),
        spec_text=reader.text("", "spec"),
        robot_text=reader.text("robot", "source")
        if reader.has_attribute("robot", "source")
        else "",
        spec_sha256=reader.text("", "spec_sha256"),
        seed=reader.integer("", "seed"),
        timings=_mapping(reader, "timings"),
        solvers=_mapping(reader, "solvers"),
        sizes=_mapping(reader, "sizes"),
        history=tuple(
            Improvement(*(float(history[name][k]) for name in HISTORY))
            for k in range(len(history["seconds"]))
        ),
        loop=_read_loop(reader) if task.integrator == "rk4" else None,
        bound=_optional(reader, "bound"),
        gap=_optional(reader, "gap"),
        warnings=reader.texts("warnings", _TEXTS),
        summary=reader.texts("summary", _TEXTS),
        verified=reader.flag("", "verified"),
        created=reader.text("", "created"),
        climbplan_version=reader.text("", "climbplan_version"),
        not_finite=tuple(reader.not_finite),
    )


def _read_task(reader: Reader, parts: dict[str, Any]) -> WalkTask:
    integrator = reader.text("", "integrator")
    if integrator not in get_args(Integrator):
        known = ", ".join(get_args(Integrator))
        raise reader.refuse(f"integrator {integrator!r}, expected one of {known}")
    reader.group("robot")
    robot = {
        name: reader.array(f"robot/{name}", layout)
        for name, layout in ROBOT.items()
        if layout.kind != "text"
    }
    ground = {
        name: reader.array(f"ground/{name}", layout)
        for name, layout in GROUND.items()
        if layout.kind != "text"
    }
    if not len(ground["height"]):
        raise reader.refuse("ground has no region")
    weights = {
        name: reader.array(f"weights/{name}", Layout((3,))) for name in ("velocity", "angles")
    }
    return WalkTask(
        body=RigidBody(
            name=reader.text("robot", "name"),
            leg_names=reader.texts("robot/leg_names", ROBOT["leg_names"]),
            mass=reader.number("robot", "mass"),
            gravity=reader.number("robot", "gravity"),
            force_limit=reader.number("robot", "force_limit"),
            **robot,
        ),
        ground=Ground(
            names=reader.texts("ground/names", GROUND["names"]),
            friction=reader.number("robot", "friction"),
            **ground,
        ),
        knots=len(parts["time"]) - 1,
        step=reader.number("", "step"),
        integrator=integrator,  # type: ignore[arg-type]  # one of them, as was just checked
        start=Start(
            reader.array("start/state", START["state"]), reader.array("start/toes", START["toes"])
        ),
        reference=Reference(
            parts["reference/velocity"][1:],
            parts["reference/euler_zyx"][1:],
            parts["reference/height"][1:],
        ),
        weights=Weights(
            weights["velocity"],
            weights["angles"],
            *(reader.number("weights", name) for name in ("height", "motion", "force_difference")),
        ),
        lift=reader.number("", "lift"),
        least_contacts=reader.integer("", "least_contacts"),
        whole_stance=reader.flag("", "whole_stance"),
    )


def _read_loop(reader: Reader) -> LoopRecord:
    parts = {name: reader.array(name, layout) for name, layout in LOOP.items()}
    return LoopRecord(warnings=reader.texts("tick_warnings", _TEXTS), **parts)


def _optional(reader: Reader, name: str) -> float | None:
    return reader.number("", name) if reader.has_attribute("", name) else None


def _mapping(reader: Reader, name: str) -> dict[str, Any]:
    value = reader.json("", name)
    if not isinstance(value, dict):
        raise reader.refuse(f"attribute {name} is not a JSON object")
    return value
