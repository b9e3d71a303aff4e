"""The one checker of LIMMS plans of every method: all rules, at 1 ms, from the file alone."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from climbplan.arrays import Array
from climbplan.limms.check.boxes import box_checks
from climbplan.limms.check.dense import events
from climbplan.limms.check.kinematics import placed
from climbplan.limms.check.limits import judge
from climbplan.limms.check.logic import RULES, broken
from climbplan.limms.check.masses import mass_checks
from climbplan.limms.check.motion import motion_checks
from climbplan.limms.check.spec import spec_checks
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.scene.limms_scene import Pose
from climbplan.limms.schema.module import OF_MASSES, ModuleSpec
from climbplan.schema.holding import HeldSpec
from climbplan.verification.check import Check
from climbplan.verification.held import held_check


def plan_checks(plan: LimmsPlan, held: HeldSpec | None = None) -> Iterator[Check]:
    """All checks; if text or numbers are unsound, only those: nothing else would mean anything.

    held: a spec that the plan is to answer in place of its own.
    """
    same = hashlib.sha256(plan.spec_text.encode()).hexdigest() == plan.spec_sha256
    yield judge("file.spec_hash", 0.0 if same else 1.0)
    finite = judge("file.finite", float(len(plan.not_finite)), ", ".join(plan.not_finite[:1]))
    yield finite
    if not finite.passed:
        return
    faults, module = _data_faults(plan)
    data = judge("file.data", float(len(faults)), faults[0] if faults else "")
    yield data
    if not data.passed or module is None:
        return
    if held is None:
        yield from spec_checks(plan)
    else:
        yield held_check(held)
        yield from spec_checks(replace(plan, spec_text=held.text, module_text=held.module_text))
    yield from _samples(plan)
    yield from _logic(plan)
    yield _points(plan, module)
    yield _rates(plan)
    yield from motion_checks(plan, module)
    yield from box_checks(plan, module)
    yield from mass_checks(plan, module)


def at_time(plan: LimmsPlan, sample: int) -> str:
    """Where a sample is: time and stage."""
    time = float(plan.motion.time[sample])
    stage = next((name for name, a, b in plan.stages if a - 1e-9 <= time <= b + 1e-9), "")
    return f"{time:.3f} s" + (f", {stage}" if stage else "")


def _data_faults(plan: LimmsPlan) -> tuple[list[str], ModuleSpec | None]:
    faults = []
    module = None
    try:
        module = ModuleSpec.model_validate(plan.module)
    except ValidationError as error:
        faults.append(f"module: {error.errors()[0]['msg']}")
    missing = [name for name in ModuleSpec.model_fields if name not in plan.module]
    if plan.massless:  # plans of before modules had masses do not say where they are
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
    for name, values, known in (
        ("box/mode", motion.box_mode, BOX_MODES),
        ("limms/mode", motion.mode, MODULE_MODES),
    ):
        strange = np.unique(values[~np.isin(values, tuple(known))])
        faults += [f"{name} {m} is none" for m in strange[:1]]
    if not np.isin(motion.ground_end, (-1, 0, 1)).all():
        faults.append("limms/ground_end not one of -1, 0, 1")
    top = len(plan.anchor_names) + 2 * len(plan.module_names)
    for name in ("base_anchor", "tip_anchor"):
        values = vars(motion)[name]
        if (values < -1).any() or (values >= top).any():
            faults.append(f"limms/{name} out of range")
    still = motion.anchor_position[:, 4 * len(plan.box_size) :]
    if still.size and np.ptp(still, axis=0).max() > 0:
        faults.append("anchors/position: those of the terrain move")
    if len(motion.time) < 3 or motion.time[-1] <= motion.time[0]:
        faults.append("time: no motion")
    return faults, module


def _samples(plan: LimmsPlan) -> Iterator[Check]:
    motion = plan.motion
    step = np.diff(motion.time)
    k = int(np.argmax(step))
    back = float(-step.min())
    yield judge("samples.rate", np.inf if back > 0 else step[k], at_time(plan, k))
    event = np.flatnonzero(step == 0)
    jump = np.zeros(len(event))
    for values in (
        motion.box_position,
        motion.box_velocity,
        motion.box_yaw,
        motion.box_yaw_rate,
        motion.joint_position,
    ):
        flat = values.reshape(len(motion.time), -1)
        jump = np.maximum(jump, np.abs(flat[event + 1] - flat[event]).max(axis=1, initial=0))
    turn = np.abs(motion.joint_angles[event + 1] - motion.joint_angles[event])
    if len(event):
        jump = np.maximum(jump, turn.max(axis=(1, 2)))
    worst = int(np.argmax(jump)) if len(event) else 0
    place = at_time(plan, int(event[worst])) if len(event) else ""
    yield judge("samples.continuous", jump.max(initial=0.0), place)
    # Modes may change only at events
    changes = np.zeros(len(step), bool)
    ends = (motion.base_anchor, motion.tip_anchor, motion.ground_end)
    for labels in (motion.box_mode, motion.mode, *ends):
        changes |= (np.diff(labels, axis=0) != 0).any(axis=1)
    stray = np.flatnonzero(changes & (step > 0))
    if len(stray):
        yield judge("samples.continuous", np.inf, f"modes change within {at_time(plan, stray[0])}")


def _logic(plan: LimmsPlan) -> Iterator[Check]:
    for rule, samples in broken(plan).items():
        name = "logic.anchors" if rule == 0 else f"logic.rule_{rule}"
        at = np.flatnonzero(samples)
        place = f"{at_time(plan, int(at[0]))}: {RULES.get(rule, '')}" if len(at) else ""
        yield judge(name, float(len(at)), place)


def _rates(plan: LimmsPlan) -> Check:
    """Check the stored joint velocities against the joint angles."""
    motion = plan.motion
    worst, place = 0.0, ""
    for first, last in events(motion.time):
        span = slice(first, last + 1)
        off = _off_rates(motion.time[span], motion.joint_angles[span], motion.joint_velocity[span])
        k = np.unravel_index(int(np.argmax(off)), off.shape)
        if not off[k] <= worst:
            worst = float(off[k])
            place = f"{at_time(plan, first + int(k[0]) + 1)}: {plan.module_names[int(k[1])]}"
    return judge("joint.rates", worst, place)


def _off_rates(time: Array, angles: Array, rates: Array) -> Array:
    """Return by how much rates (n, L, 6) are not those of angles, between samples (n - 1, L, 6).

    The mean of two rates is the change of the angle over the time h between them, but for a twelfth
    of h^2 times the third derivative. Half of the second difference of such changes is let pass.
    """
    change = np.diff(angles, axis=0) / np.diff(time)[:, None, None]
    off = np.abs(change - (rates[1:] + rates[:-1]) / 2)
    if len(change) < 3:
        return off
    bend = np.abs(np.diff(change, n=2, axis=0))
    near = np.concatenate([bend[:1], bend[:1], bend, bend[-1:], bend[-1:]])
    return off - 0.5 * np.maximum(np.maximum(near[:-2], near[1:-1]), near[2:])


def _points(plan: LimmsPlan, module: ModuleSpec) -> Check:
    motion = plan.motion
    base = Pose(motion.joint_position[:, :, 0], motion.joint_rotation[:, :, 0])
    own = placed(module, 0, base, motion.joint_angles)
    off = np.maximum(
        np.abs(own.position - motion.joint_position).max(axis=(1, 2, 3)),
        np.abs(own.rotation - motion.joint_rotation).max(axis=(1, 2, 3, 4)),
    )
    frame = base.rotation @ np.swapaxes(base.rotation, -1, -2) - np.eye(3)
    off = np.maximum(off, np.abs(frame).max(axis=(1, 2, 3)))
    off = np.maximum(off, np.where(np.linalg.det(base.rotation).min(axis=1) > 0, 0, np.inf))
    k = int(np.argmax(off))
    return judge("kinematics.points", off[k], at_time(plan, k))
