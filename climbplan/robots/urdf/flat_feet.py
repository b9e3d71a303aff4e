"""Soles of flat feet from a robot section and its URDF: how they lie under the last links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import Sole
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import LegAtZero
from climbplan.schema.document import Finding
from climbplan.schema.robots.urdf.robot import UrdfRobot

_MAX_AXIS_ANGLE = 20.0  # [deg] of an axis of a toe's link from up, and from forward
_CAPSULE_CLEARANCE = 2e-3  # [m] of the capsule around a foot from the ground


def build_soles(robot: UrdfRobot, legs: list[LegAtZero], chain: SerialChain) -> Sole:
    """Return soles along the axes of the toes' links that point up and forward in the posture.

    Raises:
        SpecError: No axis of a link does.
    """
    foot = robot.spec.foot
    assert foot is not None
    assert foot.length is not None
    assert foot.width is not None
    turns = chain.pose(chain.posture).turns[:, -1]
    axes, findings = np.empty((len(legs), 3, 3)), []
    for limb, leg in enumerate(legs):
        link = robot.spec.legs[robot.limb_names[limb]].toe
        axes_in_posture = turns[limb] @ leg.toe_axes  # columns: axes of the link in the posture
        selected = []
        for row, direction in ((2, "up"), (1, "forward")):
            axis = int(np.argmax(np.abs(axes_in_posture[row])))
            cosine = min(abs(axes_in_posture[row, axis]), 1.0)
            angle = float(np.rad2deg(np.arccos(cosine)))
            if angle > _MAX_AXIS_ANGLE:
                message = (
                    f"no axis of link {link!r} points {direction} in the leg's posture, the "
                    f"nearest is {angle:.0f} deg off; a sole lies along the axes of its toe's "
                    "link: expected a `posture_deg` in which it is level, within "
                    f"{_MAX_AXIS_ANGLE:g} deg, or another link"
                )
                findings.append(Finding(("legs", robot.limb_names[limb], "toe"), message))
                break
            selected.append(np.sign(axes_in_posture[row, axis]) * leg.toe_axes[:, axis])
        else:
            normal, along = selected
            axes[limb] = np.stack([np.cross(along, normal), along, normal], axis=-1)
    if findings:
        raise robot.build_error(findings)
    return Sole(float(foot.length), float(foot.width), axes)


def move_toes_to_soles(chain: SerialChain, sole: Sole, center: tuple[float, float]) -> SerialChain:
    """Return chains whose toes are the middles of their soles.

    center: forward and right of the toes [m].
    """
    forward, right = center
    offset = forward * sole.axes_zero[..., 1] + right * sole.axes_zero[..., 0]
    return replace(chain, toe_zero=chain.toe_zero + offset)


def build_sole_capsules(chain: SerialChain, sole: Sole) -> tuple[Array, float]:
    """Return capsules that stand for feet: ends (N, 2, 3) of their axes, and their radius [m].

    They are as long and as wide as the sole and lie on it. Obstacles next to a foot collide with
    its capsule; the ground under it is checked corner by corner.
    """
    half_width, half_length = sole.half_size
    radius = float(min(half_width, half_length))
    step = np.stack([-1.0, 1.0]) * float(max(half_length - half_width, 0.0))
    middle = chain.toe_zero + (radius + _CAPSULE_CLEARANCE) * sole.axes_zero[..., 2]
    ends = middle[:, None] + step[:, None] * sole.axes_zero[:, None, :, 1]
    return np.asarray(ends), radius
