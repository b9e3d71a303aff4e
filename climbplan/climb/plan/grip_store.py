"""Grips inside a plan file: grippers, the model of their spines, and what they do."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from climbplan.climb.plan.grips import GripForces, GripPlan, SpineModel
from climbplan.robots.gripper import Gripper
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_datasets

GROUP = "grips"
INPUTS = 4  # alpha, beta, gamma, friction
GRIPPER = {
    "wrist_max_torque": DatasetLayout((3,), "N m"),
    "wrist_lower": DatasetLayout((3,), "rad"),
    "wrist_upper": DatasetLayout((3,), "rad"),
}
GRIPPER_NUMBERS = {"length": "m", "finger_span": "m", "max_force": "N"}
MODEL = {
    "state": DatasetLayout(("*", INPUTS)),
    "force": DatasetLayout(("*",), "N"),
    "center": DatasetLayout((INPUTS,)),
    "scale": DatasetLayout((INPUTS,)),
}
MODEL_NUMBERS = ("signal", "length", "noise")
SPINES = DatasetLayout(("R",), "N")
FORCE = DatasetLayout(("T", "N", 3), "N", "world")
STATES = {"instants": "K", "trajectory": "T"}
WRISTS = {
    "wrist_angles": DatasetLayout(("K", "N", 3), "rad"),
    "wrist_torque": DatasetLayout(("K", "N", 3), "N m"),
    "pull_margin": DatasetLayout(("K", "N"), "N", may_be_infinite=True),
}


def _build_force_layouts(count: str) -> dict[str, DatasetLayout]:
    return {
        "grip": DatasetLayout((count, "N"), "N"),
        "palm": DatasetLayout((count, "N", 3), "N", "world"),
        "moment": DatasetLayout((count, "N", 3), "N m", "world"),
    }


def write_gripper(group: h5py.Group, gripper: Gripper | None) -> None:
    """Add the group `gripper` of a robot that has some."""
    if gripper is None:
        return
    subgroup = group.create_group("gripper")
    for name in GRIPPER_NUMBERS:
        subgroup.attrs[name] = float(vars(gripper)[name])
    write_datasets(subgroup, GRIPPER, vars(gripper))


def read_gripper(reader: Reader) -> Gripper | None:
    """Return the grippers of a plan's robot; None if it has none."""
    where = "robot/gripper"
    if not reader.has(where):
        return None
    numbers: dict[str, Any] = {name: reader.number(where, name) for name in GRIPPER_NUMBERS}
    arrays: dict[str, Any] = reader.datasets(where, GRIPPER)
    return Gripper(**numbers, **arrays)


def write_grips(file: h5py.File, grips: GripPlan | None) -> None:
    """Add the group `grips` of a plan that has some."""
    if grips is None:
        return
    group = file.create_group(GROUP)
    group.attrs["risk"] = float(grips.risk)
    model = group.create_group("model")
    for name in MODEL_NUMBERS:
        model.attrs[name] = float(vars(grips.model)[name])
    write_datasets(model, MODEL, vars(grips.model))
    write_dataset(group, "spines", grips.spines, SPINES)
    write_datasets(group, WRISTS, vars(grips))
    for name, count in STATES.items():
        target = group.create_group(name)
        for quantity, layout in _build_force_layouts(count).items():
            write_dataset(target, quantity, vars(vars(grips)[name])[quantity], layout)
    write_dataset(group["trajectory"], "force", grips.trajectory_force, FORCE)


def read_grips(reader: Reader, gripper: Gripper | None) -> GripPlan | None:
    """Return the grips of a plan; None without grippers.

    Raises PlanFileError if only one of grippers and grips is there.
    """
    if reader.has(GROUP) != (gripper is not None):
        raise reader.refuse("robot/gripper and grips belong together, one of them is missing")
    if gripper is None:
        return None
    where = f"{GROUP}/model"
    numbers: dict[str, Any] = {name: reader.number(where, name) for name in MODEL_NUMBERS}
    arrays: dict[str, Any] = {
        name: np.asarray(reader.array(f"{where}/{name}", s)) for name, s in MODEL.items()
    }
    if not len(arrays["state"]) or len(arrays["force"]) != len(arrays["state"]):
        raise reader.refuse(f"{where} holds {len(arrays['state'])} states, as many forces expected")
    states: dict[str, Any] = {
        name: GripForces(
            **{
                quantity: reader.array(f"{GROUP}/{name}/{quantity}", layout)
                for quantity, layout in _build_force_layouts(count).items()
            }
        )
        for name, count in STATES.items()
    }
    wrists: dict[str, Any] = reader.datasets(GROUP, WRISTS)
    return GripPlan(
        risk=reader.number(GROUP, "risk"),
        model=SpineModel(**arrays, **numbers),
        spines=reader.array(f"{GROUP}/spines", SPINES),
        trajectory_force=reader.array(f"{GROUP}/trajectory/force", FORCE),
        **states,
        **wrists,
    )
