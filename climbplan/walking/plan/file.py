"""MPC plan files (HDF5): write them, and read them back exactly."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast, get_args

import h5py
import numpy as np

from climbplan.deprecation import current_method_name
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets, write_text
from climbplan.store.root_attributes import (
    read_header,
    read_status,
    require_finite,
    require_plan,
    write_header,
)
from climbplan.walking.plan.answer import Improvement
from climbplan.walking.plan.task_file import START, read_task, write_task
from climbplan.walking.plan.walk_plan import STATUSES, Forward, LoopRecord, WalkPlan
from climbplan.walking.task.task import (
    ANGLES,
    POSITION,
    SPIN,
    STATE,
    VELOCITY,
    Gait,
    WalkTrajectory,
)

FORMAT = "climbplan/mpc"
FORMAT_VERSION = 1

# T samples, S regions, H improvements; legs in the order of robot/leg_names
SAMPLES = {
    "time": DatasetLayout(("T",), "s"),
    "com": DatasetLayout(("T", 3), "m", "world"),
    "velocity": DatasetLayout(("T", 3), "m/s", "world"),
    "euler_zyx": DatasetLayout(("T", 3), "rad", "roll, pitch, yaw of R = Rz Ry Rx, body to world"),
    "angular_velocity": DatasetLayout(("T", 3), "rad/s", "world"),
    "toes": DatasetLayout(("T", "L", 3), "m", "world"),
    "contact": DatasetLayout(("T", "L"), kind="bool"),
    "region": DatasetLayout(("T", "L"), kind="int"),
    "force": DatasetLayout(("T", "L", 3), "N", "world, on the robot"),
    "reference/velocity": DatasetLayout(("T", 3), "m/s", "world"),
    "reference/euler_zyx": DatasetLayout(("T", 3), "rad", "roll, pitch, yaw"),
    "reference/height": DatasetLayout(("T",), "m", "world"),
}
HISTORY = {
    "seconds": DatasetLayout(("H",), "s"),
    "objective": DatasetLayout(("H",), "", may_be_infinite=True),
    "bound": DatasetLayout(("H",), "", may_be_infinite=True),
}
LOOP = {
    "push": DatasetLayout(("T", 3), "m/s", "world"),
    "tick_time": DatasetLayout(("T",), "s"),
    "solve_time": DatasetLayout(("T",), "s"),
    "candidates_tried": DatasetLayout(("T",), kind="int"),
    "winner": DatasetLayout(("T",), kind="int"),
}
BEGUN = DatasetLayout(("T", STATE), "m, m/s, rad, rad/s", "world, as com, velocity, euler_zyx, ...")
_TEXTS = DatasetLayout(("*",), kind="text")
_DEFAULT_SAMPLES = 16  # in an interval, for files without the attribute
_AXES = {
    "x": "body frame x forward, y left, z up; world frame z up",
    "y": "body frame x forward, y left, z up; world frame x right, y forward, z up, as in climbs: "
    "a body that faces forward has a yaw of pi / 2",
}
_NOTES = {
    "force_is": "constant from sample n to n + 1; zeros at the last",
    "contact_is": "whether the leg stands from sample n to n + 1",
    "reference_is": "of samples 1 to T - 1; that of sample 0 repeats sample 1",
}


def write_walk_plan(plan: WalkPlan, path: Path) -> None:
    """Write a plan; the file appears complete or not at all, and replaces an existing one.

    An empty `created` or `climbplan_version` becomes now and this version.

    Raises:
        UsageError: the file cannot be written.
    """
    task, trajectory = plan.task, plan.trajectory
    with create_store(path) as file:
        _write_header(file, plan)
        reference = task.reference
        samples = {
            "time": task.dt * np.arange(task.knots + 1),
            "com": trajectory.state[:, POSITION],
            "velocity": trajectory.state[:, VELOCITY],
            "euler_zyx": trajectory.state[:, ANGLES],
            "angular_velocity": trajectory.state[:, SPIN],
            "toes": trajectory.toes,
            "contact": trajectory.gait.contact,
            "region": trajectory.gait.region,
            "force": trajectory.force,
            "reference/velocity": _repeat_first_row(reference.velocity),
            "reference/euler_zyx": _repeat_first_row(reference.euler),
            "reference/height": _repeat_first_row(reference.height),
        }
        write_datasets(file, SAMPLES, samples)
        write_task(file, task)
        if plan.robot_text:
            write_text(file["robot"], "source", plan.robot_text)
        if plan.robot_urdf:
            write_text(file["robot"], "urdf", plan.robot_urdf)
        history = file.create_group("history")
        history_columns = {name: [vars(step)[name] for step in plan.history] for name in HISTORY}
        write_datasets(history, HISTORY, history_columns)
        if plan.initial_states is not None:
            write_dataset(file, "begun", plan.initial_states, BEGUN)
        if plan.loop is not None:
            write_datasets(file, LOOP, vars(plan.loop))
            write_dataset(file, "tick_warnings", plan.loop.warnings, _TEXTS)
            file.attrs["samples_per_interval"] = plan.loop.samples


def read_walk_plan(path: Path) -> WalkPlan:
    """Read the plan of a file, exactly as it was written.

    Raises:
        PlanFileError: the file is not a complete MPC plan.
    """
    plan = read_unchecked_plan(path)
    require_finite(path, plan)
    return plan


def read_unchecked_plan(path: Path) -> WalkPlan:
    """Read a plan like `read_walk_plan`, but only list numbers that are not finite, for a check."""
    with open_store(path) as file:
        reader = Reader(path, file)
        require_plan(reader, FORMAT_VERSION, FORMAT)
        return _read_plan(reader)


def _repeat_first_row(values: Any) -> Any:
    """Return values with the first row twice, because sample 0 has no reference."""
    return np.concatenate([values[:1], values])


def _write_header(file: h5py.File, plan: WalkPlan) -> None:
    """Write the root attributes of a plan."""
    task = plan.task
    texts = {"title": plan.title, "method": plan.method, "integrator": task.integrator}
    write_header(
        file,
        plan,
        FORMAT,
        FORMAT_VERSION,
        texts={
            "status": plan.status,
            **texts,
            "axes": _AXES[plan.forward],
            "forward": plan.forward,
            **_NOTES,
        },
        numbers={
            "objective": plan.objective,
            "bound": plan.bound,
            "gap": plan.gap,
            "step": task.dt,
            "lift": task.swing_clearance,
        },
        objects={"terms": dict(plan.terms)},
    )
    file.attrs["least_contacts"] = task.min_contacts
    file.attrs["whole_stance"] = np.bool_(task.workspace_over_stance)


def _read_plan(reader: Reader) -> WalkPlan:
    """Read a plan from an open file."""
    datasets = reader.datasets("", SAMPLES)
    if len(datasets["time"]) < 2:
        raise reader.refuse("time has fewer than two samples")
    task = read_task(reader, datasets)
    for name in ("state", "toes"):
        datasets[f"start/{name}"] = reader.array(f"start/{name}", START[name])
    region = datasets["region"]
    if region.size and not (region.min() >= 0 and region.max() < len(task.ground.height)):
        raise reader.refuse("region names a region that is not there")
    trajectory = WalkTrajectory(
        np.concatenate(
            [datasets[name] for name in ("com", "velocity", "euler_zyx", "angular_velocity")],
            axis=1,
        ),
        datasets["toes"],
        datasets["force"],
        Gait(datasets["contact"], region),
    )
    online = task.integrator == "rk4"
    forward = reader.text("", "forward") if reader.has_attribute("", "forward") else "x"
    if forward not in get_args(Forward):
        raise reader.refuse(f"forward is {forward!r}, expected x or y")
    times = task.dt * np.arange(len(datasets["time"]))
    history = reader.datasets("history", HISTORY)
    return WalkPlan(
        title=reader.text("", "title"),
        method=current_method_name("mpc", reader.text("", "method")),
        status=read_status(reader, STATUSES),
        task=task,
        trajectory=trajectory,
        objective=reader.number("", "objective"),
        terms=reader.figures("terms"),
        forward=cast("Forward", forward),
        robot_text=_read_robot_text(reader, "source"),
        robot_urdf=_read_robot_text(reader, "urdf"),
        history=tuple(
            Improvement(*(float(history[name][k]) for name in HISTORY))
            for k in range(len(history["seconds"]))
        ),
        loop=_read_loop(reader) if online else None,
        initial_states=reader.array("begun", BEGUN) if reader.has("begun") else None,
        bound=reader.optional_number("bound"),
        gap=reader.optional_number("gap"),
        at_odds=() if np.allclose(datasets["time"], times, rtol=0, atol=1e-9) else ("time",),
        **read_header(reader, *(((), ()) if online else (("method",), ("gaits tried",)))),
    )


def _read_robot_text(reader: Reader, name: str) -> str:
    """Return a text of the robot; empty if there is none."""
    return reader.text("robot", name) if reader.has_attribute("robot", name) else ""


def _read_loop(reader: Reader) -> LoopRecord:
    """Read the record of a closed loop."""
    datasets = reader.datasets("", LOOP)
    is_stored = reader.has_attribute("", "samples_per_interval")
    samples = reader.integer("", "samples_per_interval") if is_stored else _DEFAULT_SAMPLES
    if samples < 1:
        raise reader.refuse(f"samples_per_interval is {samples}")
    return LoopRecord(warnings=reader.texts("tick_warnings", _TEXTS), samples=samples, **datasets)
