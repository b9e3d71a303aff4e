"""The closed inverse kinematics of an arm in symbols: what `chain.inverse` does with numbers.

The box does not turn, so that the joint angles of an arm are functions of the box's centre alone,
in one branch. Angles are told round a reference, so that they run on where a full turn ends. Out
of reach they run on smoothly: there only `margins` means anything.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.scene import Array, Scene
from climbplan.limms.statement import Limb

_SOFT = 1e-4  # below which squares of sines count as zero, smoothly


def arm_function(scene: Scene, limb: Limb) -> ca.Function:
    """Of box centre (3), its velocity (3) and reference angles (6): angles (6), rates (6), margins.

    Margins (3): squared distance [m^2] of the wrist from the first joint's axis, cosines of elbow
    and wrist; these two are 1 where branches meet, and the elbow's is more out of reach.
    """
    each = arm_symbols(scene, limb)
    given = [each.centre, each.velocity, each.reference]
    return ca.Function("arm", given, [each.angles, each.rates, each.margins])


@dataclass(frozen=True)
class ArmSymbols:
    """An arm in symbols: what is given, and what follows."""

    centre: ca.SX  # (3,) of the box [m]
    velocity: ca.SX  # (3,) of the box [m/s]
    reference: ca.SX  # (6,) angles about which angles are told [rad]
    angles: ca.SX  # (6,) [rad]
    rates: ca.SX  # (6,) [rad/s]
    margins: ca.SX  # (3,) as of `arm_function`


def arm_symbols(scene: Scene, limb: Limb) -> ArmSymbols:
    """Angles, rates and margins of an arm as closed expressions."""
    centre, velocity = ca.SX.sym("centre", 3), ca.SX.sym("velocity", 3)
    reference = ca.SX.sym("reference", 6)
    on_box = centre + ca.DM(scene.side_offset(0, limb.side))
    fixed = ca.SX(ca.DM(limb.fixed_position))
    first, last = (on_box, fixed) if limb.box_end == 0 else (fixed, on_box)
    r_first, r_last = limb.other_rotation, limb.box_rotation
    if limb.box_end == 0:
        r_first, r_last = r_last, r_first
    angles, margins = _inverse(scene, limb.branch, first, last, r_first, r_last, reference)
    rates = ca.jtimes(angles, centre, velocity)
    return ArmSymbols(centre, velocity, reference, angles, rates, margins)


def _inverse(
    scene: Scene,
    branch: tuple[int, int, int],
    first: ca.SX,
    last: ca.SX,
    r_first: Array,
    r_last: Array,
    reference: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """Angles (6) and margins (3), as `chain.inverse` step by step."""
    a = scene.module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    shoulder, elbow, flip = branch
    wrist = last - ca.DM((a[5] + a[6]) * r_last[:, 2])
    local = ca.DM(r_first.T) @ (wrist - first)
    yaw = _near(shoulder * local[1], shoulder * local[0], reference[0])
    square = local[0] ** 2 + local[1] ** 2
    reach = shoulder * ca.sqrt(square + _SOFT**2)
    height = local[2] - a[0] - a[1]
    cosine = (square + height**2 - upper**2 - fore**2) / (2 * upper * fore)
    sine = _root(1 - cosine**2)
    bend = elbow * ca.atan2(sine, cosine)
    lean = ca.atan2(reach, height) - ca.atan2(elbow * fore * sine, upper + fore * cosine)
    pitch = _near(ca.sin(lean), ca.cos(lean), reference[1])
    before = ca.SX(ca.DM(r_first.T @ r_last))
    for joint, angle in enumerate((yaw, pitch, bend)):
        before = _turn(angle, ROLLS[joint]).T @ before
    roll4 = _near(flip * before[1, 2], flip * before[0, 2], reference[3])
    bend5 = flip * ca.atan2(_root(1 - before[2, 2] ** 2), before[2, 2])
    roll6 = _near(flip * before[2, 1], -flip * before[2, 0], reference[5])
    angles = ca.vertcat(yaw, pitch, bend, roll4, bend5, roll6)
    return angles, ca.vertcat(square, cosine, before[2, 2])


def _near(y: ca.SX, x: ca.SX, reference: ca.SX) -> ca.SX:
    """The angle of (x, y) within half a turn of a reference."""
    c, s = ca.cos(reference), ca.sin(reference)
    return reference + ca.atan2(y * c - x * s, x * c + y * s)


def _root(square: ca.SX) -> ca.SX:
    """A square root that is smooth and positive for negative numbers too."""
    return ca.sqrt((square + ca.sqrt(square**2 + _SOFT**2)) / 2)


def _turn(angle: ca.SX, is_roll: bool) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    if is_roll:
        return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def least_margins(singular: tuple[float, float, float]) -> tuple[Array, Array]:
    """Bounds (3,) and (3,) of the margins: wrist off the axis [m], elbow and wrist bent [rad]."""
    off, elbow, wrist = singular
    low = np.array([off**2, -np.inf, -np.inf])
    high = np.array([np.inf, np.cos(elbow), np.cos(wrist)])
    return low, high
