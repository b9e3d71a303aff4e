"""Soles of flat feet from a robot section and its URDF: which way they lie under the last links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.foot import Sole
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import LegAtZero
from climbplan.schema.document import Finding
from climbplan.schema.robots.urdf.robot import UrdfRobot

_MOST_OFF = 20.0  # [deg] that an axis of a toe's link may be off up, and off forward
_ABOVE = 2e-3  # [m] that the capsule round a foot keeps from what the sole lies on


def sole_of(robot: UrdfRobot, legs: list[LegAtZero], chain: SerialChain) -> Sole:
    """Soles along the axes of the toes' links that point up and forward in the posture.

    Raises SpecError for legs of which no axis does.
    """
    foot = robot.spec.foot
    assert foot is not None
    assert foot.length is not None
    assert foot.width is not None
    turns = chain.pose(chain.posture).turns[:, -1]
    axes, found = np.empty((len(legs), 3, 3)), []
    for limb, leg in enumerate(legs):
        link = robot.spec.legs[robot.limb_names[limb]].toe
        here = turns[limb] @ leg.toe_axes  # columns: axes of the link in the posture
        picked = []
        for place, way in ((2, "up"), (1, "forward")):
            axis = int(np.argmax(np.abs(here[place])))
            off = float(np.rad2deg(np.arccos(min(abs(here[place, axis]), 1.0))))
            if off > _MOST_OFF:
                message = (
                    f"no axis of link {link!r} points {way} in the leg's posture, the nearest is "
                    f"{off:.0f} deg off; a sole lies along the axes of its toe's link: expected a "
                    f"`posture_deg` in which it is level, within {_MOST_OFF:g} deg, or another link"
                )
                found.append(Finding(("legs", robot.limb_names[limb], "toe"), message))
                break
            picked.append(np.sign(here[place, axis]) * leg.toe_axes[:, axis])
        else:
            normal, along = picked
            axes[limb] = np.stack([np.cross(along, normal), along, normal], axis=-1)
    if found:
        raise robot.refused(found)
    return Sole(float(foot.length), float(foot.width), axes)


def with_soles(chain: SerialChain, sole: Sole, center: tuple[float, float]) -> SerialChain:
    """Chains whose toes are the middles of their soles; center: forward and right of the toes."""
    forward, right = center
    moved = forward * sole.axes_zero[..., 1] + right * sole.axes_zero[..., 0]
    return replace(chain, toe_zero=chain.toe_zero + moved)


def sole_capsules(chain: SerialChain, sole: Sole) -> tuple[Array, float]:
    """Ends (N, 2, 3) of the axes, and the radius [m], of capsules that stand for feet.

    As long and as wide as the sole, on it: what is beside a foot meets it there, and what it lies
    on is looked at corner by corner.
    """
    across, along = sole.half_size
    radius = float(min(across, along))
    step = np.stack([-1.0, 1.0]) * float(max(along - across, 0.0))
    middle = chain.toe_zero + (radius + _ABOVE) * sole.axes_zero[..., 2]
    ends = middle[:, None] + step[:, None] * sole.axes_zero[:, None, :, 1]
    return np.asarray(ends), radius
