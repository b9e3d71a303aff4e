"""What limbs other than coxa, femur and tibia are made of, in the group `robot` of plan files."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import h5py
import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.layout import BODY_PART, CAPSULES, JOINT_DYNAMICS, LINKS, TOUCHING
from climbplan.robots.five_bar import FiveBar, Linkage
from climbplan.robots.joint_dynamics import JointDynamics
from climbplan.robots.link_masses import LinkMasses
from climbplan.robots.mechanism import Mechanism
from climbplan.robots.model import MountedCapsules, Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_datasets

CHAIN = {
    "joint_zero": DatasetLayout(("N", "J", 3), "m", "body"),
    "axis_zero": DatasetLayout(("N", "J", 3), "", "body"),
    "toe_zero": DatasetLayout(("N", 3), "m", "body"),
    "posture": DatasetLayout(("N", "J"), "rad"),
}
# Of chains with joints that slide, or that follow others, alone
MORE_OF_CHAIN = {
    "slide_zero": DatasetLayout(("N", "J", 3), "", "body"),
    "drive": DatasetLayout(("N", "J", "J"), ""),
}
_NAMES = DatasetLayout(("*",), kind="text")  # limb by limb, J each, empty where a limb has fewer
_MASS_OFF = 1e-9  # of the whole, by which masses together may differ from it
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
    write_datasets(chain, CHAIN, vars(mechanism))
    write_datasets(chain, MORE_OF_CHAIN, vars(mechanism), optional=True)


def read_mechanism(reader: Reader) -> Mechanism | None:
    """Return the mechanism of a plan's robot, None for coxa, femur and tibia.

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
    arrays = reader.datasets("robot/chain", CHAIN)
    limbs, joints = arrays["posture"].shape
    if len(names) != limbs * joints:
        raise reader.refuse(
            f"robot/chain/joint_names holds {len(names)} names, expected {limbs * joints}"
        )
    rows = tuple(names[i * joints : (i + 1) * joints] for i in range(limbs))
    more = {
        name: reader.array(f"robot/chain/{name}", shape)
        for name, shape in MORE_OF_CHAIN.items()
        if reader.has(f"robot/chain/{name}")
    }
    turns = np.linalg.norm(arrays["axis_zero"], axis=-1)
    slides = np.linalg.norm(more.get("slide_zero", np.zeros((limbs, joints, 3))), axis=-1)
    expected = np.array([[float(bool(name)) for name in row] for row in rows])
    if not (np.abs(turns + slides - expected) < _UNIT).all() or (turns * slides > 0).any():
        raise reader.refuse(
            "robot/chain/axis_zero: expected unit axes, zero where no joint is, or where one "
            "slides along a unit `slide_zero`"
        )
    if "drive" in more and not _is_valid_drive(more["drive"]):
        raise reader.refuse(
            "robot/chain/drive: expected joints that move by their own angle, or by one other that "
            "does"
        )
    return SerialChain(rows, **arrays, **more)


def _is_valid_drive(drive: Array) -> bool:
    """Return whether joints (N, J, J) move by one angle each, that of a joint with an angle of its
    own.
    """
    is_independent = np.diagonal(drive, axis1=-2, axis2=-1) == 1.0  # (N, J)
    coupling = drive * (1.0 - np.eye(drive.shape[-1]))
    is_single = (coupling != 0).sum(axis=-1) <= 1
    is_alone = ~is_independent | (coupling == 0).all(axis=-1)
    is_led = (coupling == 0) | is_independent[..., None, :]
    is_closed = (np.diagonal(drive, axis1=-2, axis2=-1) == 0.0) | is_independent
    return bool(is_single.all() and is_alone.all() and is_led.all() and is_closed.all())


def write_capsules(group: h5py.Group, capsules: MountedCapsules | None) -> None:
    """Add the group `capsules`; nothing where links are straight and alike."""
    if capsules is None:
        return
    subgroup = group.create_group("capsules")
    for name, shape in CAPSULES.items():
        write_dataset(subgroup, name, vars(capsules)[name], shape)


def read_capsules(reader: Reader) -> MountedCapsules | None:
    """Return the links of a plan's robot as capsules, None where they are straight and alike.

    Raises PlanFileError for capsules of joints that the robot does not have.
    """
    if not reader.has("robot/capsules"):
        return None
    if not reader.has("robot/chain"):
        raise reader.refuse("robot/capsules: only limbs of a `chain` have capsules of their own")
    arrays = reader.datasets("robot/capsules", CAPSULES)
    joint, radius = arrays["joint"], arrays["radius"]
    if joint.shape != radius.shape or arrays["ends"].shape[:2] != radius.shape or not joint.size:
        raise reader.refuse("robot/capsules: expected as many of `joint`, `ends` and `radius`")
    if not ((joint >= 0) & (joint < reader.dimensions["J"])).all():
        raise reader.refuse("robot/capsules/joint: expected numbers of joints")
    return MountedCapsules(**arrays)


def write_links(group: h5py.Group, links: LinkMasses | None) -> None:
    """Add the group `links`; nothing where limbs weigh nothing."""
    if links is None:
        return
    subgroup = group.create_group("links")
    subgroup.attrs["body_mass"] = links.body_mass
    for name, shape in LINKS.items():
        write_dataset(subgroup, name, vars(links)[name], shape)


def read_links(reader: Reader) -> LinkMasses | None:
    """Return what the links of a plan's robot weigh, None where its limbs weigh nothing.

    Raises PlanFileError for masses that none can have, or that are not all of the robot's.
    """
    if not reader.has("robot/links"):
        return None
    if not reader.has("robot/chain"):
        raise reader.refuse("robot/links: only limbs of a `chain` have masses of their own")
    arrays = reader.datasets("robot/links", LINKS)
    body, whole = reader.number("robot/links", "body_mass"), reader.number("robot", "mass")
    if body < 0 or (arrays["mass"] < 0).any():
        raise reader.refuse("robot/links: expected masses of zero or more")
    if not abs(arrays["mass"].sum() + body - whole) <= _MASS_OFF * whole:
        raise reader.refuse(f"robot/links: expected masses that are {whole:g} kg together")
    return LinkMasses(**arrays, body_mass=body)


def write_body_parts(group: h5py.Group, robot: Robot) -> None:
    """Add what limbs keep off, beside the hull, and pairs of parts that always touch."""
    if len(robot.touching):
        write_dataset(group, "touching", robot.touching, TOUCHING)
    for number, corners in enumerate(robot.body_parts):
        write_dataset(group.require_group("body_parts"), str(number), corners, BODY_PART)


def read_body_parts(reader: Reader) -> dict[str, Any]:
    """Return fields of the robot about that, empty where the plan has none."""
    arrays: dict[str, Any] = {}
    if reader.has("robot/touching"):
        arrays["touching"] = reader.array("robot/touching", TOUCHING)
    body_parts: list[Array] = []
    while reader.has(f"robot/body_parts/{len(body_parts)}"):
        body_parts.append(reader.array(f"robot/body_parts/{len(body_parts)}", BODY_PART))
    return {**arrays, "body_parts": tuple(body_parts)}


def _read_five_bar(reader: Reader) -> FiveBar:
    where = "robot/five_bar"
    numbers = {field.name: reader.number(where, field.name) for field in fields(Linkage)}
    lengths = ("crank_f", "crank_a", "coupler", "link", "held_along")
    if not min(numbers[name] for name in lengths) > 0:
        raise reader.refuse(f"{where}: expected lengths above zero")
    return FiveBar(
        reader.array("robot/shoulder_body", DatasetLayout(("N", 3), "m", "body")),
        reader.array("robot/mount_yaw", DatasetLayout(("N",), "rad", "body")),
        Linkage(**numbers),
    )


def write_joint_dynamics(group: h5py.Group, dynamics: JointDynamics | None) -> None:
    """Add the group `joint_dynamics`; nothing where they follow from the limits of joints."""
    if dynamics is None:
        return
    subgroup = group.create_group("joint_dynamics")
    write_datasets(subgroup, JOINT_DYNAMICS, vars(dynamics))


def read_joint_dynamics(reader: Reader) -> JointDynamics | None:
    """Read what joints resist motion with; None in plan files without it.

    Raises PlanFileError for numbers below zero, and rotors without inertia.
    """
    if not reader.has("robot/joint_dynamics"):
        return None
    arrays = reader.datasets("robot/joint_dynamics", JOINT_DYNAMICS)
    for name, values in arrays.items():
        min_value = float(values.min(initial=np.inf))
        if min_value < 0 or (name == "rotor_inertia" and min_value == 0):
            expected = "> 0" if name == "rotor_inertia" else ">= 0"
            raise reader.refuse(
                f"robot/joint_dynamics/{name}: expected {expected}, got {min_value:g}"
            )
    return JointDynamics(**arrays)
