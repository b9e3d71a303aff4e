"""Symbolic form of the closed-form inverse kinematics of an arm, `chain.solve_inverse_kinematics`.

In one branch, the joint angles of an arm are functions of the placement of the box alone. Angles
are unwrapped around a reference, so they are continuous across full turns. Out of reach they
continue smoothly; there only `margins` is meaningful.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.scene.limms_scene import ModuleScene
from climbplan.limms.scene.phases import SupportModule

Symbol = TypeVar("Symbol", ca.SX, ca.MX)

_SMOOTHING = 1e-4  # squares of sines below it are smoothed to zero


def build_arm_function(scene: ModuleScene, limb: SupportModule) -> ca.Function:
    """Build the inverse kinematics of an arm.

    Returns:
        A function of box placement (D), velocity (D) and reference angles (6). Its values are
            angles
        (6), rates (6) and margins (3): squared distance of the wrist from the axis of the first
            joint
        [m^2], and the cosines of elbow and wrist. The cosines are 1 at singularities; that of the
        elbow is larger out of reach.
    """
    symbols = build_arm_symbols(scene, limb)
    inputs = [symbols.place, symbols.velocity, symbols.reference]
    return ca.Function("arm", inputs, [symbols.angles, symbols.rates, symbols.margins])


@dataclass(frozen=True)
class ArmSymbols:
    """An arm in symbols: inputs and outputs."""

    place: ca.SX  # (D,) of the box [m, rad]
    velocity: ca.SX  # (D,) of the box [m/s, rad/s]
    reference: ca.SX  # (6,) around which angles are unwrapped [rad]
    angles: ca.SX  # (6,) [rad]
    rates: ca.SX  # (6,) [rad/s]
    margins: ca.SX  # (3,) as in `build_arm_function`


def build_arm_symbols(scene: ModuleScene, limb: SupportModule) -> ArmSymbols:
    """Return angles, rates and margins of an arm as closed expressions."""
    size = len(scene.start_placement)
    place, velocity = ca.SX.sym("place", size), ca.SX.sym("velocity", size)
    reference = ca.SX.sym("reference", 6)
    frame = compute_box_frame(place)
    on_box = place[:3] + frame @ ca.DM(scene.side_offset(0, limb.side))
    fixed = ca.SX(ca.DM(limb.fixed_position))
    first, last = (on_box, fixed) if limb.box_end == 0 else (fixed, on_box)
    r_first, r_last = ca.SX(ca.DM(limb.other_rotation)), frame @ ca.DM(limb.box_rotation)
    if limb.box_end == 0:
        r_first, r_last = r_last, r_first
    angles, margins = _inverse(
        scene,
        limb.branch,
        first=first,
        last=last,
        r_first=r_first,
        r_last=r_last,
        reference=reference,
    )
    rates = ca.jtimes(angles, place, velocity)
    return ArmSymbols(place, velocity, reference, angles, rates, margins)


def compute_box_frame(place: Symbol) -> Symbol:
    """Return the rotation (3, 3) from box frame to world frame for a placement (D)."""
    return (
        type(place)(ca.DM.eye(3)) if place.numel() == 3 else _joint_rotation(place[3], is_roll=True)
    )


def _inverse(
    scene: ModuleScene,
    branch: tuple[int, int, int],
    *,
    first: ca.SX,
    last: ca.SX,
    r_first: ca.SX,
    r_last: ca.SX,
    reference: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """Return angles (6) and margins (3) by the steps of `chain.solve_inverse_kinematics`."""
    a = scene.module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    shoulder, elbow, flip = branch
    wrist = last - (a[5] + a[6]) * r_last[:, 2]
    local = r_first.T @ (wrist - first)
    yaw = _angle_near(shoulder * local[1], shoulder * local[0], reference[0])
    square = local[0] ** 2 + local[1] ** 2
    reach = shoulder * ca.sqrt(square + _SMOOTHING**2)
    height = local[2] - a[0] - a[1]
    cosine = (square + height**2 - upper**2 - fore**2) / (2 * upper * fore)
    sine = _smooth_root(1 - cosine**2)
    bend = elbow * ca.atan2(sine, cosine)
    lean = ca.atan2(reach, height) - ca.atan2(elbow * fore * sine, upper + fore * cosine)
    pitch = _angle_near(ca.sin(lean), ca.cos(lean), reference[1])
    remaining = r_first.T @ r_last
    for joint, angle in enumerate((yaw, pitch, bend)):
        remaining = _joint_rotation(angle, ROLLS[joint]).T @ remaining
    roll4 = _angle_near(flip * remaining[1, 2], flip * remaining[0, 2], reference[3])
    bend5 = flip * ca.atan2(_smooth_root(1 - remaining[2, 2] ** 2), remaining[2, 2])
    roll6 = _angle_near(flip * remaining[2, 1], -flip * remaining[2, 0], reference[5])
    angles = ca.vertcat(yaw, pitch, bend, roll4, bend5, roll6)
    return angles, ca.vertcat(square, cosine, remaining[2, 2])


def _angle_near(y: ca.SX, x: ca.SX, reference: ca.SX) -> ca.SX:
    """Return the angle of (x, y) within half a turn of a reference."""
    c, s = ca.cos(reference), ca.sin(reference)
    return reference + ca.atan2(y * c - x * s, x * c + y * s)


def _smooth_root(square: ca.SX) -> ca.SX:
    """Return a square root that is smooth and positive for negative numbers, too."""
    return ca.sqrt((square + ca.sqrt(square**2 + _SMOOTHING**2)) / 2)


def _joint_rotation(angle: Symbol, is_roll: bool) -> Symbol:
    """Return the rotation of one joint."""
    c, s = ca.cos(angle), ca.sin(angle)
    if is_roll:
        return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def compute_margin_bounds(singular: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return bounds (3,), (3,) of the margins for given distances from singularities [m, rad]."""
    axis_distance, elbow, wrist = singular
    low = np.array([axis_distance**2, -np.inf, -np.inf])
    high = np.array([np.inf, np.cos(elbow), np.cos(wrist)])
    return low, high
