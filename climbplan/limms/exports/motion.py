"""The motion of a module plan, with what modules weigh, bring and hold on to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from climbplan.arrays import Array, BoolArray
from climbplan.errors import PlanFileError
from climbplan.exports.motion import BodyMotion, JointMotion, LatchMotion, LimbShape, RobotMotion
from climbplan.limms.check.loads import loads_of_all
from climbplan.limms.modules.inertia import link_bodies
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.schema.module import ModuleSpec

_JOINTS = 6
_RADIUS = 0.02  # [m] of links in pictures
ENDS = ("first", "last")
NO_ANCHOR, GROUND = -1, -2  # in place of an anchor's number


def read_motion(path: Path) -> RobotMotion:
    """Read a plan file; raises PlanFileError for a damaged one.

    Boxes stay upright; the first end of each module is a body. Torques are those that the plan's
    checker finds, of modules that weigh what their file says.
    """
    plan = read_limms_plan(path)
    motion, module = plan.motion, _module(path, plan)
    # Where modes change a time is there twice: what comes after it counts
    last = np.append(np.diff(motion.time) > 1e-9, True)
    time = motion.time[last]
    angle = motion.joint_angles[last].reshape(len(time), -1)
    velocity = motion.joint_velocity[last].reshape(angle.shape)
    boxes = motion.box_position.shape[1]
    bodies = [
        BodyMotion(
            "box" if boxes == 1 else f"box{b}",
            motion.box_position[last, b],
            Rotation.from_rotvec(np.outer(motion.box_yaw[last, b], [0.0, 0.0, 1.0])).as_quat(),
        )
        for b in range(boxes)
    ]
    for m, name in enumerate(plan.module_names):
        rotation = Rotation.from_matrix(motion.joint_rotation[last, m, 0])
        bodies.append(BodyMotion(name, motion.joint_position[last, m, 0], rotation.as_quat()))
    names = tuple(f"{name}_joint{j}" for name in plan.module_names for j in range(1, _JOINTS + 1))
    nothing = np.zeros_like(angle)
    latches = _latches(plan, last)
    return RobotMotion(
        name=plan.name,
        robot=", ".join(plan.module_names),
        time=time,
        bodies=tuple(bodies),
        joints=JointMotion(
            names=names,
            command=angle,
            velocity=velocity,
            acceleration=np.gradient(velocity, time, axis=0) if len(time) > 2 else nothing,
            angle=angle,
            torque=_torques(plan, module, time).reshape(angle.shape),
            feedforward=nothing,
            gravity=nothing,
            gain=np.zeros(len(names)),
        ),
        contacts=None,
        latches=latches,
        limbs=tuple(
            LimbShape(name, motion.joint_position[last, m], _RADIUS)
            for m, name in enumerate(plan.module_names)
        ),
        body_size=plan.box_size[0] / 2,
        words=_words(plan, module),
        facts=_facts(plan, module, time, latches),
    )


def _module(path: Path, plan: LimmsPlan) -> ModuleSpec:
    try:
        return ModuleSpec.model_validate(plan.module)
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(str(part) for part in fault["loc"])
        raise PlanFileError(f"{path}: its module cannot be: {where}: {fault['msg']}") from error


def _words(plan: LimmsPlan, module: ModuleSpec) -> tuple[str, ...]:
    position = "modules go by position: commands are the angles themselves"
    if not plan.massless:
        return (position,)
    words = (
        f"{position}; modules have no mass in the plan: torques are those that modules of "
        f"{module.mass:g} kg would need for it"
    )
    return (words,)


def _torques(plan: LimmsPlan, module: ModuleSpec, time: Array) -> Array:
    """(T, L, 6) that motors bring: weight and inertia of links, and what modules hold [N m].

    At times of events those after them.
    """
    torque = np.zeros((len(time), len(plan.module_names), _JOINTS))
    for loads in loads_of_all(plan, module):
        own = loads.stretch.time
        inside = (time >= own[0] - 1e-9) & (time <= own[-1] + 1e-9)
        at = np.clip(np.searchsorted(own, time[inside] - 1e-9), 0, len(own) - 1)
        torque[inside] = loads.torque[at]
    return torque


def _latches(plan: LimmsPlan, kept: BoolArray) -> LatchMotion:
    """What each end of each module holds on to."""
    motion = plan.motion
    held = np.stack([motion.base_anchor[kept], motion.tip_anchor[kept]], axis=-1)  # (T, L, 2)
    held = np.where(held < 0, NO_ANCHOR, held)
    ground = motion.ground_end[kept]
    for end in range(len(ENDS)):
        stands = (ground == end) & (held[..., end] == NO_ANCHOR)
        held[..., end] = np.where(stands, GROUND, held[..., end])
    ends = tuple(f"{name}_{end}" for name in plan.module_names for end in ENDS)
    return LatchMotion(
        ends=ends,
        anchor=held.reshape(len(held), -1),
        anchor_names=(*plan.anchor_names, *ends),
        anchor_position=motion.anchor_position[kept],
    )


def _facts(
    plan: LimmsPlan, module: ModuleSpec, time: Array, latches: LatchMotion
) -> dict[str, object]:
    links = link_bodies(module)
    return {
        "massless": plan.massless,
        "torque_is": "all that motors bring: weight and inertia of links and what modules hold",
        "module": {
            "mass": module.mass,
            "max_torque": module.max_torque,
            "max_force": module.max_force,
            "latch_moment": module.latch_moment,
            "links": [
                {"length": length, "mass": mass, "com": com, "inertia": [across, across, along]}
                for length, mass, com, across, along in zip(
                    module.link_lengths,
                    links.mass.tolist(),
                    links.com.tolist(),
                    links.across.tolist(),
                    links.along.tolist(),
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
        "latch_events": _events(latches, time),
    }


def _events(latches: LatchMotion, time: Array) -> list[dict[str, object]]:
    """When which end takes hold of what and lets go of it, those held at the start first."""
    before = np.vstack([np.full_like(latches.anchor[:1], NO_ANCHOR), latches.anchor])
    found: list[dict[str, object]] = []
    for k, e in np.argwhere(before[1:] != before[:-1]).tolist():
        for event, anchor in (("open", before[k, e]), ("close", before[k + 1, e])):
            if anchor != NO_ANCHOR:
                found.append(
                    {
                        "time": float(time[k]),
                        "end": latches.ends[e],
                        "event": event,
                        "anchor": latches.name_of(int(anchor)),
                    }
                )
    return found
