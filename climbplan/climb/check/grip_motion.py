"""Grips on the way between the instants: what their shear uses, gripping force and wrists."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.check.anew.grips import PARTS, hands_at, holds_of, spine_bounds, wrist_axes
from climbplan.climb.check.anew.kinematics import Limbs
from climbplan.climb.check.subject import Subject
from climbplan.robots.gripper import WRIST_JOINTS
from climbplan.verification.check import Check, judge_worst

_NO_SHEAR = 1e-6  # of the weight


def wrist_moment_on_the_way(subject: Subject, normal: Array) -> Array | None:
    """(T, N, 3) moment about the wrists' centres [N m]; None without grippers."""
    plan = subject.plan
    if plan.robot.gripper is None or plan.grips is None:
        return None
    arm = -plan.robot.gripper.length * normal
    return plan.grips.trajectory.moment + np.cross(arm, plan.grips.trajectory_force)


def motion_grips(
    subject: Subject,
    force: Array,
    limbs: Limbs,
    instant: IntArray,
    standing: BoolArray,
    at: Callable[..., str],
) -> Iterator[Check]:
    """Checks of T samples: force (T, N, 3) as the joints press, limbs as they stand.

    instant: (T,) whose surfaces the toes are on; standing: (T, N); at: words for sample and limb.
    """
    plan = subject.plan
    gripper, grips = plan.robot.gripper, plan.grips
    if gripper is None or grips is None:
        return
    holds = holds_of(plan)
    region, normal = plan.instants.region[instant], plan.instants.normal[instant]
    bounds = spine_bounds(grips.model, grips.risk, holds)
    hands = hands_at(force, grips.trajectory, normal, region, holds, bounds, gripper.finger_span)
    there = standing[..., None]
    excess = np.where(there, np.maximum(hands.shear - hands.held, -hands.pressure), -np.inf)
    loaded = there & (hands.shear > _NO_SHEAR * subject.weight)
    use = np.where(loaded, hands.share(), 0.0)

    def part(sample: int, limb: int, index: int) -> str:
        return f"{at(sample, limb)} {PARTS[index]}"

    margin = f"S_mu {1 / use.max():.2f}" if use.any() else "no shear"
    yield judge_worst("trajectory.grip", excess / subject.weight, part, margin, used=use)
    off = np.linalg.norm(force - grips.trajectory_force, axis=-1) / subject.weight
    yield judge_worst("trajectory.contact_force", off, at)
    size = grips.trajectory.grip
    idle = np.where(standing, 0.0, np.abs(grips.trajectory.packed).max(axis=-1))
    yield judge_worst(
        "trajectory.gripping",
        np.maximum(np.maximum(size - gripper.max_force, -size), idle),
        at,
        margin=f"at most {size.max():.1f} N",
        used=size / gripper.max_force if gripper.max_force > 0 else np.zeros_like(size),
    )

    def joint(sample: int, limb: int, index: int) -> str:
        return f"{at(sample, limb)} {WRIST_JOINTS[index]}"

    link = limbs.last_link()
    angles = _wrist_angles(link, -normal, holds.axis[region])
    over = np.maximum(gripper.wrist_lower - angles, angles - gripper.wrist_upper)
    over = np.where(there, over, -np.inf)
    half = (gripper.wrist_upper - gripper.wrist_lower) / 2
    margin = f"{np.rad2deg(-over.max()):.1f} deg"
    used = np.where(there, 1 + over / half, 0.0)
    yield judge_worst("trajectory.wrist_bounds", over, joint, margin, used=used)
    moment = wrist_moment_on_the_way(subject, normal)
    assert moment is not None
    torque = np.einsum("tnji,tni->tnj", wrist_axes(link, angles), moment)
    share = np.where(there, np.abs(torque) / gripper.wrist_max_torque, 0.0)
    most = np.where(there, np.abs(torque), 0.0).max()
    yield judge_worst(
        "trajectory.wrist_torque", share - 1.0, joint, f"at most {most:.2f} N m", used=share
    )


def _wrist_angles(link: Array, approach: Array, axis: Array) -> Array:
    """(..., 3) wrist angles that hold a gripper square, by the parts of its directions."""
    x, y, z = link[..., 0, :], link[..., 1, :], link[..., 2, :]
    up = (approach * y).sum(axis=-1)
    first = np.arctan2(-(approach * z).sum(axis=-1), (approach * x).sum(axis=-1))
    second = np.arctan2(up, np.sqrt(np.maximum(1 - up**2, 0.0)))
    flat = np.stack([first, second, np.zeros_like(first)], axis=-1)
    tilted = wrist_axes(link, flat)[..., 1, :]
    across = np.cross(tilted, approach)
    third = np.arctan2((axis * tilted).sum(axis=-1), (axis * across).sum(axis=-1))
    return np.stack([first, second, third - np.pi * np.round(third / np.pi)], axis=-1)
