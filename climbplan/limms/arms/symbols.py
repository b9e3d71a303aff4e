"""The closed inverse kinematics of an arm in symbols: what `chain.inverse` does with numbers.

The joint angles of an arm are functions of the box's placement alone, its centre and, where it
turns, its yaw, in one branch. Angles are told round a reference, so that they run on where a full
turn ends. Out of reach they run on smoothly: there only `margins` means anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import ROLLS
from climbplan.limms.scene.limms_scene import Scene
from climbplan.limms.scene.phases import Limb

Symbol = TypeVar("Symbol", ca.SX, ca.MX)

_SOFT = 1e-4  # below which squares of sines count as zero, smoothly


def arm_function(scene: Scene, limb: Limb) -> ca.Function:
    """Of box placement (D), its velocity (D), reference angles (6): angles (6), rates (6), margins.

    Margins (3): squared distance [m^2] of the wrist from the first joint's axis, cosines of elbow
    and wrist; these two are 1 where branches meet, and the elbow's is more out of reach.
    """
    each = arm_symbols(scene, limb)
    given = [each.place, each.velocity, each.reference]
    return ca.Function("arm", given, [each.angles, each.rates, each.margins])


@dataclass(frozen=True)
class ArmSymbols:
    """An arm in symbols: what is given, and what follows."""

    place: ca.SX  # (D,) of the box [m, rad]
    velocity: ca.SX  # (D,) of the box [m/s, rad/s]
    reference: ca.SX  # (6,) angles about which angles are told [rad]
    angles: ca.SX  # (6,) [rad]
    rates: ca.SX  # (6,) [rad/s]
    margins: ca.SX  # (3,) as of `arm_function`


def arm_symbols(scene: Scene, limb: Limb) -> ArmSymbols:
    """Angles, rates and margins of an arm as closed expressions."""
    size = len(scene.start_placement)
    place, velocity = ca.SX.sym("place", size), ca.SX.sym("velocity", size)
    reference = ca.SX.sym("reference", 6)
    frame = box_frame(place)
    on_box = place[:3] + frame @ ca.DM(scene.side_offset(0, limb.side))
    fixed = ca.SX(ca.DM(limb.fixed_position))
    first, last = (on_box, fixed) if limb.box_end == 0 else (fixed, on_box)
    r_first, r_last = ca.SX(ca.DM(limb.other_rotation)), frame @ ca.DM(limb.box_rotation)
    if limb.box_end == 0:
        r_first, r_last = r_last, r_first
    angles, margins = _inverse(scene, limb.branch, first, last, r_first, r_last, reference)
    rates = ca.jtimes(angles, place, velocity)
    return ArmSymbols(place, velocity, reference, angles, rates, margins)


def box_frame(place: Symbol) -> Symbol:
    """Rotation (3, 3) of the box's frame to the world's, for a placement (D)."""
    return type(place)(ca.DM.eye(3)) if place.numel() == 3 else _turn(place[3], is_roll=True)


def _inverse(
    scene: Scene,
    branch: tuple[int, int, int],
    first: ca.SX,
    last: ca.SX,
    r_first: ca.SX,
    r_last: ca.SX,
    reference: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """Angles (6) and margins (3), as `chain.inverse` step by step."""
    a = scene.module.link_lengths
    upper, fore = a[2], a[3] + a[4]
    shoulder, elbow, flip = branch
    wrist = last - (a[5] + a[6]) * r_last[:, 2]
    local = r_first.T @ (wrist - first)
    yaw = _near(shoulder * local[1], shoulder * local[0], reference[0])
    square = local[0] ** 2 + local[1] ** 2
    reach = shoulder * ca.sqrt(square + _SOFT**2)
    height = local[2] - a[0] - a[1]
    cosine = (square + height**2 - upper**2 - fore**2) / (2 * upper * fore)
    sine = _root(1 - cosine**2)
    bend = elbow * ca.atan2(sine, cosine)
    lean = ca.atan2(reach, height) - ca.atan2(elbow * fore * sine, upper + fore * cosine)
    pitch = _near(ca.sin(lean), ca.cos(lean), reference[1])
    before = r_first.T @ r_last
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


def _turn(angle: Symbol, is_roll: bool) -> Symbol:
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
