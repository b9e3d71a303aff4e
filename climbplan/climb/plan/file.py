"""Climb and transition plans as HDF5 files: writing them, and reading them back exactly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from climbplan.climb.plan import layout
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    InstantForces,
    Instants,
    Rounds,
    Sequences,
    StepLimits,
    Study,
    Trajectory,
)
from climbplan.climb.plan.grip_store import read_grips, write_grips
from climbplan.climb.plan.promise import NEEDED, Promise, parse_promise
from climbplan.climb.plan.robot_store import read_robot, read_robot_texts, write_robot
from climbplan.climb.plan.terrain_store import read_terrain, write_terrain
from climbplan.climb.plan.world_sample import REQUIRED, WorldSample, parse_sample
from climbplan.robots.model import Robot
from climbplan.robots.visual_geometry import BODY, VisualGeometry
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets, write_json
from climbplan.store.root_attributes import (
    read_header,
    read_status,
    require_finite,
    require_plan,
    write_header,
)

# How a robot looks, which only pictures read: no check does
_LOOKS = "looks"
_LOOKS_LAYOUT = {
    "vertices": DatasetLayout(("*", 3), "m", "body"),
    "faces": DatasetLayout(("*", 3), kind="int"),
    "limb": DatasetLayout(("*",), kind="int"),
    "joint": DatasetLayout(("*",), kind="int"),
}


def write_looks(group: h5py.Group, visual_geometry: VisualGeometry | None) -> None:
    """Add the group `looks` to that of a robot that has some."""
    if visual_geometry is None:
        return
    subgroup = group.create_group(_LOOKS)
    for name, form in _LOOKS_LAYOUT.items():
        value = vars(visual_geometry)[name]
        # To 0.01 mm, which halves what deflate leaves of them
        write_dataset(subgroup, name, np.round(value, 5), form, compressed=True)


def read_looks(reader: Reader, robot: Robot) -> VisualGeometry | None:
    """Return the looks of a plan's robot, None where it has none.

    Raises PlanFileError for what is misshapen or names links that are not there.
    """
    if not reader.has(f"robot/{_LOOKS}"):
        return None
    arrays = reader.datasets(f"robot/{_LOOKS}", _LOOKS_LAYOUT)
    visual_geometry = VisualGeometry(**arrays)
    count, limb, joint = len(visual_geometry.vertices), visual_geometry.limb, visual_geometry.joint
    if len(limb) != count or len(joint) != count:
        raise reader.refuse(f"robot/{_LOOKS}: {count} vertices, expected a limb and joint for each")
    if count == 0 or not len(visual_geometry.faces):
        raise reader.refuse(f"robot/{_LOOKS} holds no triangle")
    if visual_geometry.faces.min() < 0 or visual_geometry.faces.max() >= count:
        raise reader.refuse(f"robot/{_LOOKS}/faces names a vertex that is not there")
    limbs, joints = robot.joint_lower.shape
    if limb.min() < BODY or limb.max() >= limbs or joint.min() < 0 or joint.max() >= joints:
        raise reader.refuse(f"robot/{_LOOKS} names a limb or joint that is not there")
    corners = visual_geometry.faces
    if any((carried[corners] != carried[corners[:, :1]]).any() for carried in (limb, joint)):
        raise reader.refuse(f"robot/{_LOOKS}/faces holds a triangle between two links")
    return visual_geometry


def write_climb(plan: ClimbPlan, path: Path) -> None:
    """Write a plan; the file appears whole or not at all, in place of one that is there.

    An empty `created` or `climbplan_version` becomes now and this version. Raises UsageError if
    the file cannot be written.
    """
    with create_store(path) as file:
        _write_header(file, plan)
        robot = file.create_group("robot")
        write_robot(robot, plan.robot, plan.robot_texts)
        write_looks(robot, plan.looks)
        write_datasets(file.create_group("rounds"), layout.ROUNDS, vars(plan.rounds))
        instants = file.create_group("instants")
        write_datasets(instants, layout.INSTANTS, vars(plan.instants))
        write_datasets(instants, layout.FORCES, vars(plan.forces))
        if plan.forces.corner_force is not None:
            write_dataset(instants, "corner_force", plan.forces.corner_force, layout.CORNER_FORCE)
        if plan.forces.link_torques is not None:
            write_dataset(instants, "link_torques", plan.forces.link_torques, layout.LINK_TORQUES)
        _write_trajectory(file.create_group("trajectory"), plan.trajectory)
        limits = file.create_group("limits")
        write_datasets(limits, layout.LIMITS, vars(plan.limits))
        for name in layout.LIMITS_NUMBERS:
            limits.attrs[name] = float(vars(plan.limits)[name])
        write_terrain(file.create_group("terrain"), plan.terrain)
        write_grips(file, plan.grips)
        if plan.study is not None:
            _write_study(file.create_group("study"), plan.study)
        if plan.sequences is not None:
            group = file.create_group("sequences")
            write_datasets(group, layout.SEQUENCES_TEXTS, vars(plan.sequences))
            write_datasets(group, layout.SEQUENCES, vars(plan.sequences))


def read_climb(path: Path) -> ClimbPlan:
    """Return the plan in a file, exactly as it was written.

    Nothing in a file is ever run. Raises PlanFileError for anything that is not a whole climb
    plan: another format or version, missing or misshapen data, NaN where numbers must be.
    """
    plan = read_as_found(path)
    require_finite(path, plan)
    return plan


def read_as_found(path: Path) -> ClimbPlan:
    """Read a plan and only list NaN and infinities, so that a check can report them."""
    with open_store(path) as file:
        reader = Reader(path, file)
        require_plan(reader, layout.FORMAT_VERSION, *layout.FORMATS.values())
        return _read(reader)


def _write_header(file: h5py.File, plan: ClimbPlan) -> None:
    texts = {"status": plan.status}
    if plan.kind == "transition":
        texts["contact_sequence"] = plan.contact_sequence
    if plan.promise is not None:
        write_json(file, "risk", plan.promise.as_dict())
    if plan.sample is not None:
        write_json(file, "worlds", plan.sample.as_dict())
    write_header(
        file,
        plan,
        layout.FORMATS[plan.kind],
        layout.FORMAT_VERSION,
        texts=texts,
        numbers={"objective": plan.objective, "bound": plan.bound, "gap": plan.gap},
    )


def _write_trajectory(group: h5py.Group, trajectory: Trajectory) -> None:
    write_datasets(group, layout.TRAJECTORY, vars(trajectory))
    if trajectory.is_paced:
        write_datasets(group, layout.PACED, vars(trajectory))
        if trajectory.moment is not None:
            write_dataset(group, "moment", trajectory.moment, layout.PACED_MOMENT)


def _write_study(group: h5py.Group, study: Study) -> None:
    write_dataset(group, "keys", study.keys, layout.TEXTS)
    write_dataset(group, "labels", Study.LABELS, layout.TEXTS)
    write_dataset(group, "label", study.label, layout.STUDY_LABEL)
    write_dataset(group, "detail", study.detail, layout.TEXTS)
    for index, values in enumerate(study.values):
        write_dataset(group, f"values_{index}", values, layout.STUDY_VALUES)


def _read(reader: Reader) -> ClimbPlan:
    kinds = {name: kind for kind, name in layout.FORMATS.items()}
    kind = kinds[reader.text("", "format")]
    robot = read_robot(reader)
    rounds = Rounds(**reader.datasets("rounds", layout.ROUNDS))
    instants = Instants(**reader.datasets("instants", layout.INSTANTS))
    forces = InstantForces(**reader.datasets("instants", layout.FORCES))
    if robot.sole is not None:
        pushes = reader.array("instants/corner_force", layout.CORNER_FORCE)
        forces = replace(forces, corner_force=pushes)
    if robot.links is not None:
        link_torques = reader.array("instants/link_torques", layout.LINK_TORQUES)
        forces = replace(forces, link_torques=link_torques)
    trajectory = _read_trajectory(reader, robot)
    bounds = reader.datasets("limits", layout.LIMITS)
    bounds |= {
        name: reader.number("limits", name)
        for name in layout.LIMITS_NUMBERS
        if name not in layout.LATER_LIMITS or reader.has_attribute("limits", name)
    }
    limits = StepLimits(**bounds)
    _require_counts(reader, kind)
    terrain = read_terrain(reader, "terrain")
    grips = read_grips(reader, robot.gripper)
    if grips is not None:
        forces = replace(forces, grips=grips.instants)
        trajectory = replace(trajectory, grips=grips.trajectory, force=grips.trajectory_force)
    for name, region in (("rounds/region", rounds.region), ("instants/region", instants.region)):
        if region.min() < 0 or region.max() >= len(terrain.surfaces):
            raise reader.refuse(
                f"{name} names a surface that is not there (0 to {len(terrain.surfaces) - 1})"
            )
    return ClimbPlan(
        robot=robot,
        terrain=terrain,
        rounds=rounds,
        instants=instants,
        forces=forces,
        trajectory=trajectory,
        limits=limits,
        status=read_status(reader, layout.STATUSES),
        objective=reader.number("", "objective"),
        bound=reader.optional_number("bound"),
        gap=reader.optional_number("gap"),
        study=_read_study(reader) if reader.has("study") else None,
        kind=kind,
        sequences=_read_sequences(reader) if reader.has("sequences") else None,
        grips=grips,
        robot_texts=read_robot_texts(reader),
        looks=read_looks(reader, robot),
        promise=_read_promise(reader),
        sample=_read_sample(reader),
        **read_header(reader),
    )


def _read_trajectory(reader: Reader, robot: Robot) -> Trajectory:
    trajectory = Trajectory(**reader.datasets("trajectory", layout.TRAJECTORY))
    if not reader.has("trajectory/torque"):
        return trajectory
    if robot.gripper is not None:
        raise reader.refuse("trajectory/torque: expected none, of a robot with grippers")
    loads = reader.datasets("trajectory", layout.PACED)
    if robot.sole is not None:
        loads["moment"] = reader.array("trajectory/moment", layout.PACED_MOMENT)
    return replace(trajectory, **loads)


def _require_counts(reader: Reader, kind: str) -> None:
    """Refuse dimensions that contradict one another, and anything empty."""
    size = reader.dimensions
    min_limbs = 2 if reader.has("robot/foot/axes_zero") else 3  # with flat feet two are enough
    if size["N"] < min_limbs:
        raise reader.refuse(f"robot has {size['N']} limbs, expected at least {min_limbs}")
    if size["M1"] < 2:
        raise reader.refuse("rounds holds no round")
    expected = 2 * size["N"] * (size["M1"] - 1)
    if kind == "transition":
        if size["K"] % 2 or size["K"] < 2 * (size["M1"] - 1):
            raise reader.refuse(
                f"instants holds {size['K']} instants, expected at least 2 for each of "
                f"{size['M1'] - 1} rounds, and an even number"
            )
    elif size["K"] != expected:
        raise reader.refuse(
            f"instants holds {size['K']} instants, expected 2 for each of {size['N']} limbs in "
            f"each of {size['M1'] - 1} rounds: {expected}"
        )
    if size["T"] < 2:
        raise reader.refuse("trajectory holds fewer than two samples")


def _read_sequences(reader: Reader) -> Sequences:
    fields = layout.SEQUENCES_TEXTS | layout.SEQUENCES
    return Sequences(**reader.datasets("sequences", fields))


def _read_promise(reader: Reader) -> Promise | None:
    if not reader.has_attribute("", "risk"):
        return None
    stored_values = reader.mapping("risk", NEEDED)
    try:
        return parse_promise(stored_values)
    except (TypeError, ValueError, OverflowError) as error:
        raise reader.refuse(f"attribute risk is damaged: {error}") from error


def _read_sample(reader: Reader) -> WorldSample | None:
    if not reader.has_attribute("", "worlds"):
        return None
    values = reader.mapping("worlds", REQUIRED)
    try:
        return parse_sample(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise reader.refuse(f"attribute worlds is damaged: {error}") from error


def _read_study(reader: Reader) -> Study:
    keys = reader.texts("study/keys", layout.TEXTS)
    if len(keys) not in (1, 2):
        raise reader.refuse(f"study/keys holds {len(keys)} keys, expected one or two")
    label = reader.array("study/label", layout.STUDY_LABEL)
    values = tuple(
        reader.array(f"study/values_{index}", layout.STUDY_VALUES) for index in range(len(keys))
    )
    shape = tuple(len(v) for v in values) + (1,) * (2 - len(values))
    detail = reader.texts("study/detail", layout.TEXTS)
    if label.shape != shape or len(detail) != label.size:
        raise reader.refuse("study/label and study/detail do not fit study/values")
    if label.size and not (label.min() >= 0 and label.max() < len(Study.LABELS)):
        raise reader.refuse(f"study/label leaves the range 0 to {len(Study.LABELS) - 1}")
    return Study(keys=keys, values=values, label=label, detail=detail)
