"""The task of an MPC plan in its file: robot, ground, start, references and weights."""

from __future__ import annotations

from typing import Any, cast, get_args

import h5py
import numpy as np

from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.store.hdf5_layout import Layout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_text
from climbplan.walking.task.ground import Ground
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
    "inertia": Layout((3, 3), "kg m^2", "body"),
    "toe_center": Layout(("L", 3), "m", "body"),
    "toe_half": Layout((3,), "m", "body"),
    "leg_names": Layout(("L",), kind="text"),
}
# Planes that toes stand on; attributes `edge` and, of spherical feet, `standoff` [m]: how far they
# lie before the ground, along its normals
GROUND = {
    "lower": Layout(("S", 2), "m", "world"),
    "upper": Layout(("S", 2), "m", "world"),
    "height": Layout(("S",), "m", "world"),
    "names": Layout(("S",), kind="text"),
}
SHAPES = {  # of grounds that are not level rectangles, C corners
    "slope": Layout(("S", 2), "", "rise along x and y of the world"),
    "corners": Layout(("S", "C", 2), "m", "world"),
}
START = {
    "state": Layout((12,), "m, m/s, rad, rad/s", "world"),
    "toes": Layout(("L", 3), "m", "world"),
}


LEGS_OF_URDF = {  # of a robot from a URDF: chains of J joints at zero angles
    "joint_zero": Layout(("L", "J", 3), "m", "body, points on the joint axes at zero angles"),
    "axis_zero": Layout(("L", "J", 3), "", "body, unit axes of joints at zero angles"),
    "toe_zero": Layout(("L", 3), "m", "body, at zero angles"),
    "posture": Layout(("L", "J"), "rad", "as it stands"),
}
# Of legs with joints that slide, or that mimic others, alone
MORE_OF_LEGS = {
    "slide_zero": Layout(("L", "J", 3), "", "body, unit, of joints that slide at zero angles"),
    "drive": Layout(("L", "J", "J"), "", "motions of joints by angles"),
}
MOTORS = {  # of joints that slide in m, N and m/s
    "lower": Layout(("L", "J"), "rad"),
    "upper": Layout(("L", "J"), "rad"),
    "max_torque": Layout(("L", "J"), "N m"),
    "max_speed": Layout(("L", "J"), "rad/s"),
}
_NAMES = Layout(("M",), kind="text")  # leg by leg
GOAL = {"lower": Layout((2,), "m", "world"), "upper": Layout((2,), "m", "world")}


def write_task(file: h5py.File, task: WalkTask) -> None:
    """Robot, ground, start and weights; references are samples of the plan."""
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
    if task.legs is not None:
        legs = robot.create_group("legs")
        for name, layout in LEGS_OF_URDF.items():
            write_dataset(legs, name, vars(task.legs.chain)[name], layout)
        for name, layout in MORE_OF_LEGS.items():
            if vars(task.legs.chain)[name] is not None:
                write_dataset(legs, name, vars(task.legs.chain)[name], layout)
        for name, layout in MOTORS.items():
            write_dataset(legs, name, vars(task.legs)[name], layout)
        names = [name for own in task.legs.chain.names for name in own]
        write_dataset(legs, "joint_names", names, _NAMES)
    ground = file.create_group("ground")
    for name, layout in GROUND.items():
        write_dataset(ground, name, vars(task.ground)[name], layout)
    for name in ("edge", "standoff"):
        if vars(task.ground)[name]:
            ground.attrs[name] = vars(task.ground)[name]
    if task.ground.slope.any() or task.ground.corners.size:
        for name, layout in SHAPES.items():
            write_dataset(ground, name, vars(task.ground)[name], layout)
    start = file.create_group("start")
    for name, layout in START.items():
        write_dataset(start, name, vars(task.start)[name], layout)
    if task.goal.stated:
        goal = file.create_group("goal")
        for name, layout in GOAL.items():
            write_dataset(goal, name, vars(task.goal)[name], layout)
    weights = file.create_group("weights")
    for name in ("velocity", "angles"):
        write_dataset(weights, name, vars(task.weights)[name], Layout((3,)))
    for name in ("height", "motion", "force_difference"):
        weights.attrs[name] = vars(task.weights)[name]


def read_task(reader: Reader, parts: dict[str, Any]) -> WalkTask:
    """The task of a file; parts: its samples, of which the references are.

    Raises PlanFileError for a value that no task has.
    """
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

    def number_or_zero(group: str, name: str) -> float:
        """What plans that were written before they had it do not tell."""
        return reader.number(group, name) if reader.has_attribute(group, name) else 0.0

    count = len(ground["height"])
    ground["slope"], ground["corners"] = np.zeros((count, 2)), np.zeros((count, 0, 2))
    for name, layout in SHAPES.items():
        if reader.has(f"ground/{name}"):
            ground[name] = reader.array(f"ground/{name}", layout)
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
            edge=number_or_zero("ground", "edge"),
            standoff=number_or_zero("ground", "standoff"),
            **ground,
        ),
        knots=len(parts["time"]) - 1,
        step=reader.number("", "step"),
        integrator=cast("Integrator", integrator),  # one of them, as was just checked
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
        legs=_legs(reader) if reader.has("robot/legs") else None,
        lift=reader.number("", "lift"),
        least_contacts=reader.integer("", "least_contacts"),
        whole_stance=reader.flag("", "whole_stance"),
        goal=Goal(*(reader.array(f"goal/{name}", layout) for name, layout in GOAL.items()))
        if reader.has("goal")
        else Goal.anywhere(),
    )


def _legs(reader: Reader) -> WalkingLegs:
    parts = {
        name: reader.array(f"robot/legs/{name}", layout)
        for name, layout in (LEGS_OF_URDF | MOTORS).items()
    }
    names = reader.texts("robot/legs/joint_names", _NAMES)
    legs, joints = parts["posture"].shape
    if len(names) != legs * joints:
        count = legs * joints
        raise reader.refuse(f"robot/legs/joint_names has {len(names)} names, expected {count}")
    each = tuple(tuple(names[joints * leg : joints * (leg + 1)]) for leg in range(legs))
    more = {
        name: reader.array(f"robot/legs/{name}", layout)
        for name, layout in MORE_OF_LEGS.items()
        if reader.has(f"robot/legs/{name}")
    }
    chain = SerialChain(each, *(parts.pop(name) for name in LEGS_OF_URDF), **more)
    return WalkingLegs(chain, **parts)
