"""How a robot looks, inside a plan file: only pictures read it, no check does."""

from __future__ import annotations

import h5py
import numpy as np

from climbplan.robots.looks import BODY, Looks
from climbplan.robots.model import Robot
from climbplan.store.hdf5_layout import Layout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset

_GROUP = "looks"
_LAYOUT = {
    "vertices": Layout(("*", 3), "m", "body"),
    "faces": Layout(("*", 3), kind="int"),
    "limb": Layout(("*",), kind="int"),
    "joint": Layout(("*",), kind="int"),
}


def write_looks(group: h5py.Group, looks: Looks | None) -> None:
    """Add the group `looks` to that of a robot that has some."""
    if looks is None:
        return
    own = group.create_group(_GROUP)
    for name, layout in _LAYOUT.items():
        value = vars(looks)[name]
        # To 0.01 mm, which halves what deflate leaves of them
        write_dataset(own, name, np.round(value, 5), layout, compressed=True)


def read_looks(reader: Reader, robot: Robot) -> Looks | None:
    """The looks of a plan's robot, None where it has none.

    Raises PlanFileError for what is misshapen or names links that are not there.
    """
    if not reader.has(f"robot/{_GROUP}"):
        return None
    found = {name: reader.array(f"robot/{_GROUP}/{name}", form) for name, form in _LAYOUT.items()}
    looks = Looks(**found)
    count, limb, joint = len(looks.vertices), looks.limb, looks.joint
    if len(limb) != count or len(joint) != count:
        raise reader.refuse(f"robot/{_GROUP}: {count} vertices, expected a limb and joint for each")
    if count == 0 or not len(looks.faces):
        raise reader.refuse(f"robot/{_GROUP} holds no triangle")
    if looks.faces.min() < 0 or looks.faces.max() >= count:
        raise reader.refuse(f"robot/{_GROUP}/faces names a vertex that is not there")
    limbs, joints = robot.joint_lower.shape
    if limb.min() < BODY or limb.max() >= limbs or joint.min() < 0 or joint.max() >= joints:
        raise reader.refuse(f"robot/{_GROUP} names a limb or joint that is not there")
    corners = looks.faces
    if any((carried[corners] != carried[corners[:, :1]]).any() for carried in (limb, joint)):
        raise reader.refuse(f"robot/{_GROUP}/faces holds a triangle between two links")
    return looks
