"""The task of an MPC plan in its file: robot, terrain, start, references and weights."""

from __future__ import annotations

from typing import Any, cast, get_args

import h5py
import numpy as np

from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_datasets, write_text
from climbplan.terrain.raw_surface import RawSurface
from climbplan.walking.task.ground import Ground, raise_scan
from climbplan.walking.task.task import (
    Goal,
    Integrator,
    Reference,
    RigidBody,
    Start,
    WalkTask,
    Weights,
)

# S regions; L legs in the order of robot/leg_names
ROBOT = {
    "inertia": DatasetLayout((3, 3), "kg m^2", "body"),
    "toe_center": DatasetLayout(("L", 3), "m", "body"),
    "toe_half": DatasetLayout((3,), "m", "body"),
    "leg_names": DatasetLayout(("L",), kind="text"),
}
# Planes that toes stand on; attributes `edge` and, of spherical feet, `standoff` [m]: how far they
# lie before the ground, along its normals
GROUND = {
    "lower": DatasetLayout(("S", 2), "m", "world"),
    "upper": DatasetLayout(("S", 2), "m", "world"),
    "height": DatasetLayout(("S",), "m", "world"),
    "names": DatasetLayout(("S",), kind="text"),
}
SHAPES = {  # of grounds that are not level rectangles, C corners
    "slope": DatasetLayout(("S", 2), "", "rise along x and y of the world"),
    "corners": DatasetLayout(("S", "C", 2), "m", "world"),
}
PERMISSIONS = {  # of grounds whose regions differ in friction, or are not for all legs
    "region_friction": DatasetLayout(("S",)),
    "allowed": DatasetLayout(("S", "L"), kind="bool"),
}
SCAN = {  # raw surface, in the group `ground/scan` with attributes `flatness` and `toe_radius` [m]
    "vertices": DatasetLayout(("*", 3), "m", "world"),
    "triangles": DatasetLayout(("*", 3), kind="int"),
}
_SCAN_NUMBERS = ("flatness", "toe_radius")
START = {
    "state": DatasetLayout((12,), "m, m/s, rad, rad/s", "world"),
    "toes": DatasetLayout(("L", 3), "m", "world"),
}


LEGS_OF_URDF = {  # of a robot from a URDF: chains of J joints at zero angles
    "joint_zero": DatasetLayout(
        ("L", "J", 3), "m", "body, points on the joint axes at zero angles"
    ),
    "axis_zero": DatasetLayout(("L", "J", 3), "", "body, unit axes of joints at zero angles"),
    "toe_zero": DatasetLayout(("L", 3), "m", "body, at zero angles"),
    "posture": DatasetLayout(("L", "J"), "rad", "as it stands"),
}
# Of legs with joints that slide, or that mimic others, alone
MORE_OF_LEGS = {
    "slide_zero": DatasetLayout(
        ("L", "J", 3), "", "body, unit, of joints that slide at zero angles"
    ),
    "drive": DatasetLayout(("L", "J", "J"), "", "motions of joints by angles"),
}
MOTORS = {  # of joints that slide in m, N and m/s
    "lower": DatasetLayout(("L", "J"), "rad"),
    "upper": DatasetLayout(("L", "J"), "rad"),
    "max_torque": DatasetLayout(("L", "J"), "N m"),
    "max_speed": DatasetLayout(("L", "J"), "rad/s"),
}
_NAMES = DatasetLayout(("M",), kind="text")  # leg by leg
WEIGHTS = {"velocity": DatasetLayout((3,)), "angles": DatasetLayout((3,))}
GOAL = {"lower": DatasetLayout((2,), "m", "world"), "upper": DatasetLayout((2,), "m", "world")}


def write_task(file: h5py.File, task: WalkTask) -> None:
    """Write robot, terrain, start and weights; references are samples of the plan."""
    body = task.body
    robot = file.create_group("robot")
    write_text(robot, "name", body.name)
    robot.attrs["mass"] = body.mass
    robot.attrs["gravity"] = body.gravity
    robot.attrs["friction"] = task.ground.friction
    robot.attrs["force_limit"] = body.force_limit
    robot.attrs["inertia"] = body.inertia
    write_datasets(robot, ROBOT, vars(body))
    if task.legs is not None:
        legs = robot.create_group("legs")
        write_datasets(legs, LEGS_OF_URDF, vars(task.legs.chain))
        write_datasets(legs, MORE_OF_LEGS, vars(task.legs.chain), optional=True)
        write_datasets(legs, MOTORS, vars(task.legs))
        names = [name for leg_joints in task.legs.chain.names for name in leg_joints]
        write_dataset(legs, "joint_names", names, _NAMES)
    ground = file.create_group("ground")
    write_datasets(ground, GROUND, vars(task.ground))
    for name in ("edge", "standoff"):
        if vars(task.ground)[name]:
            ground.attrs[name] = vars(task.ground)[name]
    if task.ground.slope.any() or task.ground.corners.size:
        write_datasets(ground, SHAPES, vars(task.ground))
    for name, layout in PERMISSIONS.items():
        if vars(task.ground)[name].size:
            write_dataset(ground, name, vars(task.ground)[name], layout)
    if task.ground.scan is not None:
        scan = raise_scan(task.ground.scan, -task.ground.standoff)
        write_datasets(ground.create_group("scan"), SCAN, vars(scan))
        for name in _SCAN_NUMBERS:
            ground["scan"].attrs[name] = float(vars(scan)[name])
    start = file.create_group("start")
    write_datasets(start, START, vars(task.start))
    if task.goal.is_set:
        goal = file.create_group("goal")
        write_datasets(goal, GOAL, vars(task.goal))
    weights = file.create_group("weights")
    write_datasets(weights, WEIGHTS, vars(task.weights))
    for name in ("height", "motion", "force_difference"):
        weights.attrs[name] = vars(task.weights)[name]


def read_task(reader: Reader, samples: dict[str, Any]) -> WalkTask:
    """Read the task of a file.

    Args:
        reader: the open file.
        samples: its datasets by sample, including the references.

    Raises:
        PlanFileError: a value that no task has.
    """
    integrator = reader.text("", "integrator")
    if integrator not in get_args(Integrator):
        integrators = ", ".join(get_args(Integrator))
        raise reader.refuse(f"integrator {integrator!r}, expected one of {integrators}")
    reader.group("robot")
    robot = reader.datasets("robot", ROBOT)
    ground = _read_ground(reader)
    weights = reader.datasets("weights", WEIGHTS)
    return WalkTask(
        body=RigidBody(
            name=reader.text("robot", "name"),
            mass=reader.number("robot", "mass"),
            gravity=reader.number("robot", "gravity"),
            force_limit=reader.number("robot", "force_limit"),
            **robot,
        ),
        ground=ground,
        knots=len(samples["time"]) - 1,
        dt=reader.number("", "step"),
        integrator=cast("Integrator", integrator),  # one of them, as was just checked
        start=Start(**reader.datasets("start", START)),
        reference=Reference(
            samples["reference/velocity"][1:],
            samples["reference/euler_zyx"][1:],
            samples["reference/height"][1:],
        ),
        weights=Weights(
            weights["velocity"],
            weights["angles"],
            *(reader.number("weights", name) for name in ("height", "motion", "force_difference")),
        ),
        legs=_read_legs(reader) if reader.has("robot/legs") else None,
        swing_clearance=reader.number("", "lift"),
        min_contacts=reader.integer("", "least_contacts"),
        workspace_over_stance=reader.flag("", "whole_stance"),
        goal=Goal(**reader.datasets("goal", GOAL)) if reader.has("goal") else Goal.anywhere(),
    )


def _read_ground(reader: Reader) -> Ground:
    """Read the terrain; attributes and shapes that a file does not have are zero."""
    ground = reader.datasets("ground", GROUND)
    count = len(ground["height"])
    if not count:
        raise reader.refuse("ground has no region")
    ground["slope"], ground["corners"] = np.zeros((count, 2)), np.zeros((count, 0, 2))
    ground |= reader.datasets("ground", SHAPES, optional=True)
    ground |= reader.datasets("ground", PERMISSIONS, optional=True)
    edge, standoff = (
        reader.number("ground", name) if reader.has_attribute("ground", name) else 0.0
        for name in ("edge", "standoff")
    )
    friction = reader.number("robot", "friction")
    scan = None
    if reader.has("ground/scan"):
        fields: dict[str, Any] = reader.datasets("ground/scan", SCAN)
        corners, count = fields["triangles"], len(fields["vertices"])
        if not len(corners) or corners.min() < 0 or corners.max() >= count:
            raise reader.refuse("ground/scan/triangles is empty, or names a missing corner")
        fields |= {name: reader.number("ground/scan", name) for name in _SCAN_NUMBERS}
        scan = raise_scan(RawSurface(**fields), standoff)
    return Ground(friction=friction, edge=edge, standoff=standoff, scan=scan, **ground)


def _read_legs(reader: Reader) -> WalkingLegs:
    """Read the legs of a URDF robot."""
    datasets = reader.datasets("robot/legs", LEGS_OF_URDF | MOTORS)
    names = reader.texts("robot/legs/joint_names", _NAMES)
    legs, joints = datasets["posture"].shape
    if len(names) != legs * joints:
        count = legs * joints
        raise reader.refuse(f"robot/legs/joint_names has {len(names)} names, expected {count}")
    joint_names = tuple(tuple(names[joints * leg : joints * (leg + 1)]) for leg in range(legs))
    more = reader.datasets("robot/legs", MORE_OF_LEGS, optional=True)
    chain = SerialChain(joint_names, *(datasets.pop(name) for name in LEGS_OF_URDF), **more)
    return WalkingLegs(chain, **datasets)
