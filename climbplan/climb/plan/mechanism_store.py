"""What limbs other than coxa, femur and tibia are made of, in the group `robot` of plan files."""

from __future__ import annotations

from dataclasses import fields

import h5py
import numpy as np

from climbplan.plans.hdf5_layout import Layout
from climbplan.plans.hdf5_reading import Reader
from climbplan.plans.hdf5_writing import write_dataset
from climbplan.robots.five_bar import FiveBar, Linkage
from climbplan.robots.mechanism import Mechanism
from climbplan.robots.serial_chain import SerialChain

CHAIN = {
    "joint_zero": Layout(("N", "J", 3), "m", "body"),
    "axis_zero": Layout(("N", "J", 3), "", "body"),
    "toe_zero": Layout(("N", 3), "m", "body"),
    "posture": Layout(("N", "J"), "rad"),
}
_NAMES = Layout(("*",), kind="text")  # limb by limb, J each, empty where a limb has fewer
_UNIT = 1e-6  # by which the length of an axis may differ from one


def write_mechanism(group: h5py.Group, mechanism: Mechanism | None) -> None:
    """Add the group `chain` or `five_bar`; nothing for coxa, femur and tibia."""
    if mechanism is None:
        return
    if isinstance(mechanism, FiveBar):
        bar = group.create_group("five_bar")
        for name, value in vars(mechanism.linkage).items():
            bar.attrs[name] = float(value)
        return
    if not isinstance(mechanism, SerialChain):
        raise TypeError(f"a plan cannot hold limbs of type {type(mechanism).__name__}")
    chain = group.create_group("chain")
    write_dataset(chain, "joint_names", sum(mechanism.names, ()), _NAMES)
    for name, layout in CHAIN.items():
        write_dataset(chain, name, vars(mechanism)[name], layout)


def read_mechanism(reader: Reader) -> Mechanism | None:
    """The mechanism of a plan's robot, None for coxa, femur and tibia.

    Raises PlanFileError for chains that are none: axes of no length, or names that do not fit.
    """
    if reader.has("robot/five_bar"):
        return _read_five_bar(reader)
    if not reader.has("robot/chain"):
        if reader.dimensions["J"] != 3:
            raise reader.refuse(
                f"robot has {reader.dimensions['J']} joints a limb and no group `chain`, "
                "without which limbs are coxa, femur and tibia"
            )
        return None
    names = reader.texts("robot/chain/joint_names", _NAMES)
    arrays = {name: reader.array(f"robot/chain/{name}", shape) for name, shape in CHAIN.items()}
    limbs, joints = arrays["posture"].shape
    if len(names) != limbs * joints:
        raise reader.refuse(
            f"robot/chain/joint_names holds {len(names)} names, expected {limbs * joints}"
        )
    rows = tuple(names[i * joints : (i + 1) * joints] for i in range(limbs))
    length = np.linalg.norm(arrays["axis_zero"], axis=-1)
    expected = np.array([[float(bool(name)) for name in row] for row in rows])
    if not (np.abs(length - expected) < _UNIT).all():
        raise reader.refuse("robot/chain/axis_zero: expected unit axes, zero where no joint is")
    return SerialChain(rows, **arrays)


def _read_five_bar(reader: Reader) -> FiveBar:
    where = "robot/five_bar"
    numbers = {field.name: reader.number(where, field.name) for field in fields(Linkage)}
    lengths = ("crank_f", "crank_a", "coupler", "link", "held_along")
    if not min(numbers[name] for name in lengths) > 0:
        raise reader.refuse(f"{where}: expected lengths above zero")
    return FiveBar(
        reader.array("robot/shoulder_body", Layout(("N", 3), "m", "body")),
        reader.array("robot/mount_yaw", Layout(("N",), "rad", "body")),
        Linkage(**numbers),
    )
