"""The motion of a module plan, with masses, torques and latches of modules."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array, BoolArray
from climbplan.errors import PlanFileError
from climbplan.exports.motion import BodyMotion, ExportedJoints, LatchMotion, LimbLinks, RobotMotion
from climbplan.limms.check.loads import compute_loads
from climbplan.limms.modules.inertia import build_link_bodies
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec

_JOINTS = 6
_RADIUS = 0.02  # [m] of links in pictures
ENDS = ("first", "last")
NO_ANCHOR, GROUND = -1, -2  # instead of an anchor's number


def read_motion(path: Path) -> RobotMotion:
    """Read the motion of a plan file.

    Boxes stay upright; the first end of each module is a body. Torques are those of the plan's
    checker for modules with the masses in the file.

    Raises:
        PlanFileError: The file is damaged.
    """
    plan = read_limms_plan(path)
    motion, module = plan.motion, _load_module(path, plan)
    # Where modes change, a time occurs twice: the second sample is used
    is_last = np.append(np.diff(motion.time) > 1e-9, True)
    time = motion.time[is_last]
    angle = motion.joint_angles[is_last].reshape(len(time), -1)
    velocity = motion.joint_velocity[is_last].reshape(angle.shape)
    boxes = motion.box_position.shape[1]
    bodies = [
        BodyMotion(
            "box" if boxes == 1 else f"box{b}",
            motion.box_position[is_last, b],
            Rotation.from_rotvec(np.outer(motion.box_yaw[is_last, b], [0.0, 0.0, 1.0])).as_quat(),
        )
        for b in range(boxes)
    ]
    for m, name in enumerate(plan.module_names):
        rotation = Rotation.from_matrix(motion.joint_rotation[is_last, m, 0])
        bodies.append(BodyMotion(name, motion.joint_position[is_last, m, 0], rotation.as_quat()))
    names = tuple(f"{name}_joint{j}" for name in plan.module_names for j in range(1, _JOINTS + 1))
    zeros = np.zeros_like(angle)
    latches = _build_latches(plan, is_last)
    return RobotMotion(
        name=plan.name,
        robot=", ".join(plan.module_names),
        time=time,
        bodies=tuple(bodies),
        joints=ExportedJoints(
            names=names,
            command=angle,
            velocity=velocity,
            acceleration=np.gradient(velocity, time, axis=0) if len(time) > 2 else zeros,
            angle=angle,
            torque=_compute_torques(plan, module, time).reshape(angle.shape),
            feedforward=zeros,
            gravity=zeros,
            gain=np.zeros(len(names)),
        ),
        contacts=None,
        latches=latches,
        limbs=tuple(
            LimbLinks(name, motion.joint_position[is_last, m], _RADIUS)
            for m, name in enumerate(plan.module_names)
        ),
        body_size=plan.box_size[0] / 2,
        words=_describe_commands(plan, module),
        facts=_build_facts(plan, module, time, latches),
    )


def _load_module(path: Path, plan: LimmsPlan) -> ModuleSpec:
    """Return the module of a plan."""
    try:
        return ModuleSpec.model_validate(plan.module)
    except ValidationError as error:
        fault = error.errors()[0]
        location = ".".join(str(key) for key in fault["loc"])
        raise PlanFileError(f"{path}: its module cannot be: {location}: {fault['msg']}") from error


def _describe_commands(plan: LimmsPlan, module: ModuleSpec) -> tuple[str, ...]:
    """Return notes on commands and torques."""
    position = "modules go by position: commands are the angles themselves"
    if not plan.massless:
        return (position,)
    note = (
        f"{position}; modules have no mass in the plan: torques are those that modules of "
        f"{module.mass:g} kg would need for it"
    )
    return (note,)


def _compute_torques(plan: LimmsPlan, module: ModuleSpec, time: Array) -> Array:
    """Return joint torques (T, L, 6) of motors: weight and inertia of links, and loads [N m].

    At times of events the torques after them are used.
    """
    torque = np.zeros((len(time), len(plan.module_names), _JOINTS))
    for loads in compute_loads(plan, module):
        sample_times = loads.stretch.time
        inside = (time >= sample_times[0] - 1e-9) & (time <= sample_times[-1] + 1e-9)
        samples = np.clip(
            np.searchsorted(sample_times, time[inside] - 1e-9), 0, len(sample_times) - 1
        )
        torque[inside] = loads.torque[samples]
    return torque


def _build_latches(plan: LimmsPlan, is_kept: BoolArray) -> LatchMotion:
    """Return what each end of each module is latched to."""
    motion = plan.motion
    anchors = np.stack(
        [motion.base_anchor[is_kept], motion.tip_anchor[is_kept]], axis=-1
    )  # (T, L, 2)
    anchors = np.where(anchors < 0, NO_ANCHOR, anchors)
    ground = motion.ground_end[is_kept]
    for end in range(len(ENDS)):
        is_standing = (ground == end) & (anchors[..., end] == NO_ANCHOR)
        anchors[..., end] = np.where(is_standing, GROUND, anchors[..., end])
    ends = tuple(f"{name}_{end}" for name in plan.module_names for end in ENDS)
    return LatchMotion(
        ends=ends,
        anchor=anchors.reshape(len(anchors), -1),
        anchor_names=(*plan.anchor_names, *ends),
        anchor_position=motion.anchor_position[is_kept],
    )


def _build_facts(
    plan: LimmsPlan, module: ModuleSpec, time: Array, latches: LatchMotion
) -> dict[str, object]:
    """Return facts about the motion for the file."""
    links = build_link_bodies(module)
    return {
        "massless": plan.massless,
        "torque_is": "all that motors bring: weight and inertia of links and what modules hold",
        "module": {
            "mass": module.mass,
            "max_torque": module.max_torque,
            "max_force": module.max_force,
            "latch_moment": module.latch_moment,
            "links": [
                {
                    "length": length,
                    "mass": mass,
                    "com": com,
                    "inertia": [transverse, transverse, axial],
                }
                for length, mass, com, transverse, axial in zip(
                    module.link_lengths,
                    links.mass.tolist(),
                    links.com.tolist(),
                    links.transverse_inertia.tolist(),
                    links.axial_inertia.tolist(),
                    strict=True,
                )
            ],
        },
        "boxes": [
            {"mass": mass, "size": size}
            for mass, size in zip(plan.box_mass.tolist(), plan.box_size.tolist(), strict=True)
        ],
        "anchors": list(latches.anchor_names),
        "no_anchor": NO_ANCHOR,
        "ground": GROUND,
        "latch_events": _list_latch_events(latches, time),
    }


def _list_latch_events(latches: LatchMotion, time: Array) -> list[dict[str, object]]:
    """Return when ends latch and release, initial latches first."""
    anchors = np.vstack([np.full_like(latches.anchor[:1], NO_ANCHOR), latches.anchor])
    events: list[dict[str, object]] = []
    for k, e in np.argwhere(anchors[1:] != anchors[:-1]).tolist():
        for event, anchor in (("open", anchors[k, e]), ("close", anchors[k + 1, e])):
            if anchor != NO_ANCHOR:
                events.append(
                    {
                        "time": float(time[k]),
                        "end": latches.ends[e],
                        "event": event,
                        "anchor": latches.name_of(int(anchor)),
                    }
                )
    return events
