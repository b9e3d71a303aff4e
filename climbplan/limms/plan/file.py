"""LIMMS plans as HDF5 files: exact writing and reading."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from climbplan.deprecation import current_method_name
from climbplan.limms.plan.convergence import RESIDUALS, Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan, ModuleMotion
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_text
from climbplan.store.root_attributes import (
    read_header,
    read_status,
    require_finite,
    require_plan,
    write_header,
)

FORMAT = "climbplan/limms"
FORMAT_VERSION = 1
STATUSES = ("feasible", "limit")  # limit: the clock cut the search short

# T samples, B boxes, L modules, A anchors
MOTION: dict[str, tuple[str, DatasetLayout]] = {
    "time": ("time", DatasetLayout(("T",), "s")),
    "box_position": ("box/position", DatasetLayout(("T", "B", 3), "m", "world")),
    "box_velocity": ("box/velocity", DatasetLayout(("T", "B", 3), "m/s", "world")),
    "box_acceleration": ("box/acceleration", DatasetLayout(("T", "B", 3), "m/s^2", "world")),
    "box_yaw": ("box/yaw", DatasetLayout(("T", "B"), "rad", "world")),
    "box_yaw_rate": ("box/yaw_rate", DatasetLayout(("T", "B"), "rad/s", "world")),
    "box_yaw_acceleration": ("box/yaw_acceleration", DatasetLayout(("T", "B"), "rad/s^2", "world")),
    "box_mode": ("box/mode", DatasetLayout(("T", "B"), kind="int")),
    "joint_position": ("limms/joint_position", DatasetLayout(("T", "L", 8, 3), "m", "world")),
    "joint_rotation": ("limms/joint_rotation", DatasetLayout(("T", "L", 8, 3, 3), "", "world")),
    "joint_angles": ("limms/joint_angles", DatasetLayout(("T", "L", 6), "rad")),
    "joint_velocity": ("limms/joint_velocity", DatasetLayout(("T", "L", 6), "rad/s")),
    "mode": ("limms/mode", DatasetLayout(("T", "L"), kind="int")),
    "base_anchor": ("limms/base_anchor", DatasetLayout(("T", "L"), kind="int")),
    "tip_anchor": ("limms/tip_anchor", DatasetLayout(("T", "L"), kind="int")),
    "ground_end": ("limms/ground_end", DatasetLayout(("T", "L"), kind="int")),
    "anchor_position": ("anchors/position", DatasetLayout(("T", "A", 3), "m", "world")),
    "force": ("force", DatasetLayout(("T", "B", 4, 3), "N", "world")),
}
STILL: dict[str, tuple[str, DatasetLayout]] = {
    "anchor_normal": ("anchors/normal", DatasetLayout(("A", 3), "", "world")),
    "box_size": ("box/size", DatasetLayout(("B", 3), "m")),
    "box_mass": ("box/mass", DatasetLayout(("B",), "kg")),
    "goal": ("box/goal", DatasetLayout(("B", 3), "m", "world")),
    "goal_yaw": ("box/goal_yaw", DatasetLayout(("B",), "rad", "world")),
    "solids": ("terrain/solids", DatasetLayout(("S", 2, 3), "m", "world")),
}
# Without these datasets boxes keep their attitude
_TURNING = ("box_yaw", "box_yaw_rate", "box_yaw_acceleration", "goal_yaw")
# I iterations of a consensus; only plans of that method have the group
CONVERGENCE: dict[str, DatasetLayout] = {
    "attempt": DatasetLayout(("I",), kind="int"),
    "frozen": DatasetLayout(("I",), kind="int"),
    **{
        f"{name}_{statistic}": DatasetLayout(("I",), unit)
        for name, unit in RESIDUALS.items()
        for statistic in ("mean", "max")
    },
    "missed": DatasetLayout(("I",), "m"),
    "violation": DatasetLayout(("I",), "m"),
    "mixed_integer_seconds": DatasetLayout(("I",), "s"),
    "nonlinear_seconds": DatasetLayout(("I",), "s"),
}
_NAMES = DatasetLayout(("A",), kind="text")
_MODULES = DatasetLayout(("L",), kind="text")
_LINKS = DatasetLayout((7,), "m")

_NOTES = {
    "objective_is": "distance of the box from its goal at the end [m]",
    "box_modes": "1 stable, 2 free, 3 manipulated, 4 quadruped",
    "module_modes": "1 free, 2 arm, 3 added arm, 4 leg, 5 added leg",
    "ends": "base_anchor is at a module's first end, tip_anchor at its last; ground_end says which "
    "end stands on the ground (0 first, 1 last, -1 none)",
    "samples": "where modes change a time is there twice, before and after",
    "yaw_is": "boxes stay upright: box/yaw (T, B) turns a box's frame to the world's about z; "
    "anchors/normal of boxes' anchors are in the box's frame",
    "force_is": "force (T, B, 4, 3) on each box at its own four anchors, of a leg at its foot",
}


def write_limms_plan(plan: LimmsPlan, path: Path) -> None:
    """Write a plan atomically; an existing file is replaced.

    An empty `created` or `climbplan_version` becomes now and this version.

    Raises:
        UsageError: The file cannot be written.
    """
    with create_store(path) as file:
        _write_header(file, plan)
        for name in ("box", "limms", "anchors", "terrain"):
            file.create_group(name)
        for key, (name, layout) in MOTION.items():
            group, _, leaf = name.rpartition("/")
            write_dataset(file[group or "/"], leaf, vars(plan.motion)[key], layout, True)
        for key, (name, layout) in STILL.items():
            group, _, leaf = name.rpartition("/")
            write_dataset(file[group], leaf, vars(plan)[key], layout)
        if plan.convergence is not None:
            group = file.create_group("convergence")
            for key, layout in CONVERGENCE.items():
                write_dataset(group, key, vars(plan.convergence)[key], layout)
        write_dataset(file["anchors"], "name", plan.anchor_names, _NAMES)
        write_dataset(file["limms"], "name", plan.module_names, _MODULES)
        if plan.module_text:
            write_text(file["limms"], "source", plan.module_text)
        write_dataset(file["limms"], "link_lengths", plan.module["link_lengths"], _LINKS)


def read_limms_plan(path: Path) -> LimmsPlan:
    """Read the plan in a file, exactly as it was written.

    Raises:
        PlanFileError: The file is not a complete LIMMS plan: another format or version, missing or
            misshapen data, or NaN where numbers must be.
    """
    plan = read_unchecked_plan(path)
    require_finite(path, plan)
    return plan


def read_unchecked_plan(path: Path) -> LimmsPlan:
    """Read a plan as `read_limms_plan` does, but list values that are not finite, for a check."""
    with open_store(path) as file:
        reader = Reader(path, file)
        require_plan(reader, FORMAT_VERSION, FORMAT)
        return _read(reader)


def _write_header(file: h5py.File, plan: LimmsPlan) -> None:
    """Write the root attributes."""
    texts = {"title": plan.title, "method": plan.method, "sequence": plan.sequence}
    write_header(
        file,
        plan,
        FORMAT,
        FORMAT_VERSION,
        texts={"status": plan.status, **texts, **_NOTES},
        numbers={
            "objective": plan.objective,
            "arrival_speed": plan.arrival_speed,
            "friction": plan.friction,
            "force_limit": plan.module["max_force"],
        },
        objects={"module": plan.module, "stages": plan.stages},
    )
    file.attrs["massless"] = np.bool_(plan.massless)


def _read(reader: Reader) -> LimmsPlan:
    """Read all datasets and attributes."""
    has_yaw = reader.has("box/yaw")
    values: dict[str, Any] = {
        key: reader.array(name, layout)
        for key, (name, layout) in {**MOTION, **STILL}.items()
        if has_yaw or key not in _TURNING
    }
    if not has_yaw:
        boxes = reader.dimensions["B"]
        no_rotation = np.zeros((reader.dimensions["T"], boxes))
        values |= dict.fromkeys(_TURNING, no_rotation) | {"goal_yaw": np.zeros(boxes)}
    motion = ModuleMotion(**{key: values.pop(key) for key in MOTION})
    convergence = None
    if reader.has("convergence"):
        values_by_iteration = {
            key: reader.array(f"convergence/{key}", lay) for key, lay in CONVERGENCE.items()
        }
        convergence = Convergence(**values_by_iteration)
    if not len(motion.time):
        raise reader.refuse("no samples")
    if reader.dimensions["A"] < 4 * reader.dimensions["B"]:
        raise reader.refuse("fewer anchors than four on each box")
    module = reader.mapping("module")
    copies = {
        "limms/link_lengths": (reader.array("limms/link_lengths", _LINKS).tolist(), "link_lengths"),
        "force_limit": (reader.number("", "force_limit"), "max_force"),
    }
    has_source = reader.has_attribute("limms", "source")
    return LimmsPlan(
        title=reader.text("", "title"),
        method=current_method_name("limms", reader.text("", "method")),
        status=read_status(reader, STATUSES),
        motion=motion,
        anchor_names=reader.texts("anchors/name", _NAMES),
        module=module,
        module_text=reader.text("limms", "source") if has_source else "",
        at_odds=tuple(name for name, (copy, key) in copies.items() if module.get(key) != copy),
        module_names=reader.texts("limms/name", _MODULES),
        # Files without this attribute have massless modules
        massless=not reader.has_attribute("", "massless") or reader.flag("", "massless"),
        arrival_speed=reader.number("", "arrival_speed"),
        friction=reader.number("", "friction"),
        stages=_read_stages(reader),
        sequence=reader.text("", "sequence"),
        objective=reader.number("", "objective"),
        convergence=convergence,
        **values,
        **read_header(reader, ("total",), ("programs",)),
    )


def _read_stages(reader: Reader) -> tuple[tuple[str, float, float], ...]:
    """Read the stages with their times."""
    value = reader.json("", "stages")
    try:
        stages = tuple((str(name), float(start), float(end)) for name, start, end in value)
    except (TypeError, ValueError, OverflowError) as error:
        raise reader.refuse("attribute stages is not a list of names and times") from error
    if not stages:
        raise reader.refuse("attribute stages names no stage")
    return stages
