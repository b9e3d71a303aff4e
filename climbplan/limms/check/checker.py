"""The checker of LIMMS plans of every method: all rules, at 1 ms, from the file alone."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from climbplan.arrays import Array
from climbplan.limms.check.boxes import check_boxes
from climbplan.limms.check.dense import find_events
from climbplan.limms.check.kinematics import compute_points
from climbplan.limms.check.limits import judge
from climbplan.limms.check.logic import RULES, find_rule_violations
from climbplan.limms.check.masses import check_masses
from climbplan.limms.check.motion import check_motion
from climbplan.limms.check.spec import check_spec
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.scene.limms_scene import FramePoses
from climbplan.limms.schema.module import OF_MASSES, ModuleSpec
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import Check
from climbplan.verification.held import check_spec_differences


def check_plan(plan: LimmsPlan, other_spec: HeldSpec | None = None) -> Iterator[Check]:
    """Yield all checks; with invalid text or numbers only those, since the others are meaningless.

    Args:
        plan: The plan.
        other_spec: A spec to compare the plan with, in place of its own.
    """
    is_same = hashlib.sha256(plan.spec_text.encode()).hexdigest() == plan.spec_sha256
    yield judge("file.spec_hash", 0.0 if is_same else 1.0)
    finite = judge("file.finite", float(len(plan.not_finite)), ", ".join(plan.not_finite[:1]))
    yield finite
    if not finite.passed:
        return
    faults, module = _find_data_faults(plan)
    data = judge("file.data", float(len(faults)), faults[0] if faults else "")
    yield data
    if not data.passed or module is None:
        return
    if other_spec is None:
        yield from check_spec(plan)
    else:
        yield check_spec_differences(other_spec)
        yield from check_spec(
            replace(plan, spec_text=other_spec.text, module_text=other_spec.module_text)
        )
    yield from _check_samples(plan)
    yield from _check_logic(plan)
    yield _check_points(plan, module)
    yield _check_rates(plan)
    yield from check_motion(plan, module)
    yield from check_boxes(plan, module)
    yield from check_masses(plan, module)


def describe_sample(plan: LimmsPlan, sample: int) -> str:
    """Return time and stage of a sample in words."""
    time = float(plan.motion.time[sample])
    stage = next((name for name, a, b in plan.stages if a - 1e-9 <= time <= b + 1e-9), "")
    return f"{time:.3f} s" + (f", {stage}" if stage else "")


def _find_data_faults(plan: LimmsPlan) -> tuple[list[str], ModuleSpec | None]:
    """Return faults of the stored data, and the module if it is valid."""
    faults = []
    module = None
    try:
        module = ModuleSpec.model_validate(plan.module)
    except ValidationError as error:
        faults.append(f"module: {error.errors()[0]['msg']}")
    missing = [name for name in ModuleSpec.model_fields if name not in plan.module]
    if plan.massless:  # plans without masses need not store how they are distributed
        missing = [name for name in missing if name not in OF_MASSES]
    faults += [f"module: no {name}" for name in missing]
    if (plan.box_size <= 0).any():
        faults.append("box/size not > 0")
    if plan.box_mass[0] <= 0 or (plan.box_mass < 0).any():
        faults.append("box/mass not > 0")
    if plan.friction <= 0:
        faults.append("friction not > 0")
    if (plan.solids[:, 1] <= plan.solids[:, 0]).any():
        faults.append("terrain/solids: upper corner not above lower")
    if np.abs(np.linalg.norm(plan.anchor_normal, axis=1) - 1).max() > 1e-9:
        faults.append("anchors/normal not of length 1")
    faults += [f"{name} is not that of the module" for name in plan.at_odds]
    motion = plan.motion
    for name, values, valid_modes in (
        ("box/mode", motion.box_mode, BOX_MODES),
        ("limms/mode", motion.mode, MODULE_MODES),
    ):
        invalid = np.unique(values[~np.isin(values, tuple(valid_modes))])
        faults += [f"{name} {m} is none" for m in invalid[:1]]
    if not np.isin(motion.ground_end, (-1, 0, 1)).all():
        faults.append("limms/ground_end not one of -1, 0, 1")
    num_ends = len(plan.anchor_names) + 2 * len(plan.module_names)
    for name in ("base_anchor", "tip_anchor"):
        values = vars(motion)[name]
        if (values < -1).any() or (values >= num_ends).any():
            faults.append(f"limms/{name} out of range")
    fixed_anchors = motion.anchor_position[:, 4 * len(plan.box_size) :]
    if fixed_anchors.size and np.ptp(fixed_anchors, axis=0).max() > 0:
        faults.append("anchors/position: those of the terrain move")
    if len(motion.time) < 3 or motion.time[-1] <= motion.time[0]:
        faults.append("time: no motion")
    return faults, module


def _check_samples(plan: LimmsPlan) -> Iterator[Check]:
    """Yield checks of sampling rate and continuity."""
    motion = plan.motion
    step = np.diff(motion.time)
    k = int(np.argmax(step))
    time_reversal = float(-step.min())
    yield judge(
        "trajectory.rate", np.inf if time_reversal > 0 else step[k], describe_sample(plan, k)
    )
    event = np.flatnonzero(step == 0)
    jump = np.zeros(len(event))
    for values in (
        motion.box_position,
        motion.box_velocity,
        motion.box_yaw,
        motion.box_yaw_rate,
        motion.joint_position,
    ):
        values_by_sample = values.reshape(len(motion.time), -1)
        jump = np.maximum(
            jump,
            np.abs(values_by_sample[event + 1] - values_by_sample[event]).max(axis=1, initial=0),
        )
    angle_jump = np.abs(motion.joint_angles[event + 1] - motion.joint_angles[event])
    if len(event):
        jump = np.maximum(jump, angle_jump.max(axis=(1, 2)))
    index = int(np.argmax(jump)) if len(event) else 0
    location = describe_sample(plan, int(event[index])) if len(event) else ""
    yield judge("trajectory.continuity", jump.max(initial=0.0), location)
    # Modes may change only at events
    changes = np.zeros(len(step), bool)
    ends = (motion.base_anchor, motion.tip_anchor, motion.ground_end)
    for labels in (motion.box_mode, motion.mode, *ends):
        changes |= (np.diff(labels, axis=0) != 0).any(axis=1)
    within_stretch = np.flatnonzero(changes & (step > 0))
    if len(within_stretch):
        yield judge(
            "trajectory.continuity",
            np.inf,
            f"modes change within {describe_sample(plan, within_stretch[0])}",
        )


def _check_logic(plan: LimmsPlan) -> Iterator[Check]:
    """Yield the checks of the logic rules."""
    for rule, samples in find_rule_violations(plan).items():
        name = "logic.anchors" if rule == 0 else f"logic.rule_{rule}"
        violating = np.flatnonzero(samples)
        location = (
            f"{describe_sample(plan, int(violating[0]))}: {RULES.get(rule, '')}"
            if len(violating)
            else ""
        )
        yield judge(name, float(len(violating)), location)


def _check_rates(plan: LimmsPlan) -> Check:
    """Return the check of stored joint velocities against the joint angles."""
    motion = plan.motion
    max_error, location = 0.0, ""
    for first, last in find_events(motion.time):
        span = slice(first, last + 1)
        error = _compute_rate_errors(
            motion.time[span], motion.joint_angles[span], motion.joint_velocity[span]
        )
        k = np.unravel_index(int(np.argmax(error)), error.shape)
        if not error[k] <= max_error:
            max_error = float(error[k])
            location = (
                f"{describe_sample(plan, first + int(k[0]) + 1)}: {plan.module_names[int(k[1])]}"
            )
    return judge("kinematics.joint_velocity", max_error, location)


def _compute_rate_errors(time: Array, angles: Array, rates: Array) -> Array:
    """Return the differences of rates (n, L, 6) and angles between samples (n - 1, L, 6) [rad/s].

    The mean of two rates is the change of the angle over the time h between them, up to h^2 / 12
    times the third derivative. Half of the second difference of such changes is tolerated.
    """
    change = np.diff(angles, axis=0) / np.diff(time)[:, None, None]
    error = np.abs(change - (rates[1:] + rates[:-1]) / 2)
    if len(change) < 3:
        return error
    second_difference = np.abs(np.diff(change, n=2, axis=0))
    padded = np.concatenate(
        [
            second_difference[:1],
            second_difference[:1],
            second_difference,
            second_difference[-1:],
            second_difference[-1:],
        ]
    )
    return error - 0.5 * np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])


def _check_points(plan: LimmsPlan, module: ModuleSpec) -> Check:
    """Return the check of stored points against the joint angles."""
    motion = plan.motion
    base = FramePoses(motion.joint_position[:, :, 0], motion.joint_rotation[:, :, 0])
    computed = compute_points(module, 0, base, motion.joint_angles)
    error = np.maximum(
        np.abs(computed.position - motion.joint_position).max(axis=(1, 2, 3)),
        np.abs(computed.rotation - motion.joint_rotation).max(axis=(1, 2, 3, 4)),
    )
    frame = base.rotation @ np.swapaxes(base.rotation, -1, -2) - np.eye(3)
    error = np.maximum(error, np.abs(frame).max(axis=(1, 2, 3)))
    error = np.maximum(error, np.where(np.linalg.det(base.rotation).min(axis=1) > 0, 0, np.inf))
    k = int(np.argmax(error))
    return judge("kinematics.forward", error[k], describe_sample(plan, k))
