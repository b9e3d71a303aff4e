"""The robot inside a plan file: its data, and the files that they are from."""

from __future__ import annotations

from typing import Any

import h5py

from climbplan.climb.plan import layout
from climbplan.climb.plan.grip_store import read_gripper, write_gripper
from climbplan.climb.plan.mechanism_store import (
    read_body_parts,
    read_capsules,
    read_joint_dynamics,
    read_links,
    read_mechanism,
    write_body_parts,
    write_capsules,
    write_joint_dynamics,
    write_links,
    write_mechanism,
)
from climbplan.robots.foot import Foot, Sole
from climbplan.robots.model import Robot
from climbplan.schema.robots.stored import RobotTexts
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_text

_TEXTS = {"yaml": "source", "urdf": "urdf"}  # attributes, only where there is something to say


def write_robot(group: h5py.Group, robot: Robot, texts: RobotTexts) -> None:
    """Write names, data, mechanism and grippers; also the texts of a robot that is not built in."""
    write_text(group, "name", robot.name)
    for name in layout.ROBOT_NUMBERS:
        group.attrs[name] = float(vars(robot)[name])
    for name, shape in {**layout.ROBOT_TEXTS, **layout.ROBOT}.items():
        write_dataset(group, name, vars(robot)[name], shape)
    write_mechanism(group, robot.mechanism)
    write_capsules(group, robot.capsules)
    write_links(group, robot.links)
    write_joint_dynamics(group, robot.dynamics)
    write_body_parts(group, robot)
    write_gripper(group, robot.gripper)
    if robot.foot is not None:
        foot, sole = group.create_group("foot"), robot.foot.sole
        for name in layout.FOOT_NUMBERS if sole is None else layout.SOLE_NUMBERS:
            foot.attrs[name] = float(vars(robot.foot if sole is None else sole)[name])
        if sole is not None:
            write_dataset(foot, "axes_zero", sole.axes_zero, layout.SOLE_AXES)
    for name, attribute in _TEXTS.items():
        if text := vars(texts)[name]:
            write_text(group, attribute, text)


def read_robot(reader: Reader) -> Robot:
    """Return the robot of a plan; raises PlanFileError for what is missing or misshapen."""
    reader.group("robot")
    fields: dict[str, Any] = reader.datasets("robot", layout.ROBOT_TEXTS)
    fields |= {name: reader.number("robot", name) for name in layout.ROBOT_NUMBERS}
    fields |= reader.datasets("robot", layout.ROBOT)
    fields["mechanism"] = read_mechanism(reader)
    fields["capsules"] = read_capsules(reader)
    fields["links"] = read_links(reader)
    fields["dynamics"] = read_joint_dynamics(reader)
    fields |= read_body_parts(reader)
    fields["gripper"] = read_gripper(reader)
    if reader.has("robot/foot"):
        fields["foot"] = _read_foot(reader)
    return Robot(name=reader.text("robot", "name"), **fields)


def _read_foot(reader: Reader) -> Foot:
    """Return spherical feet, or flat ones where there are axes of soles."""
    if not reader.has("robot/foot/axes_zero"):
        return Foot(radius=reader.number("robot/foot", "radius"))
    numbers = {n: reader.number("robot/foot", n) for n in layout.SOLE_NUMBERS}
    axes = reader.array("robot/foot/axes_zero", layout.SOLE_AXES)
    return Foot(sole=Sole(**numbers, axes_zero=axes))


def read_robot_texts(reader: Reader) -> RobotTexts:
    """Return the files that the robot is from, as far as the plan carries them."""
    return RobotTexts(
        **{
            name: reader.text("robot", attribute)
            for name, attribute in _TEXTS.items()
            if reader.has_attribute("robot", attribute)
        }
    )
