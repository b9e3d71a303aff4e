"""Five-bar legs built anew from the lengths in a plan file: intersections of circles in the plane.

A leg's plane holds x outward from the yaw axis and z up. Angles of cranks count from straight down
towards outward. What crank speeds do to the last link is found by difference quotients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.five_bar import FiveBar

_STEP = 1e-6  # [rad]


@dataclass(frozen=True)
class FiveBarPose:
    """N legs in the body frame, with the serial joints that would move them alike."""

    joints: Array  # (..., N, 3, 3) yaw axis, crank F's axis, elbow [m]
    axes: Array  # (..., N, 3, 3) unit axes there
    toe: Array  # (..., N, 3) [m]
    drive: Array  # (..., N, 3, 3) speeds about these axes by speeds of yaw, crank F, crank A


def five_bars_at(legs: FiveBar, angles: Array) -> FiveBarPose:
    """Legs at motor angles (..., N, 3) [rad]; NaN where the linkage does not close."""
    bar = legs.linkage
    yaw = legs.mount_yaw + angles[..., 0]
    f, a = angles[..., 1], angles[..., 2]
    tilt = _tilt(legs, f, a)
    by_f = (_tilt(legs, f + _STEP, a) - _tilt(legs, f - _STEP, a)) / (2 * _STEP)
    by_a = (_tilt(legs, f, a + _STEP) - _tilt(legs, f, a - _STEP)) / (2 * _STEP)
    hip_x, hip_z = bar.offset + 0 * f, bar.axis_f + 0 * f
    elbow_x, elbow_z = hip_x + bar.crank_f * np.sin(f), hip_z - bar.crank_f * np.cos(f)
    toe_x, toe_z = elbow_x + bar.link * np.sin(tilt), elbow_z - bar.link * np.cos(tilt)

    def placed(x: Array, z: Array) -> Array:
        return legs.shoulder_body + np.stack([x * np.cos(yaw), x * np.sin(yaw), z], axis=-1)

    one, zero = np.ones_like(f), np.zeros_like(f)
    up = np.stack([zero, zero, one], axis=-1)
    hinge = np.stack([np.sin(yaw), -np.cos(yaw), zero], axis=-1)
    rows = [[one, zero, zero], [zero, one, zero], [zero, by_f - 1.0, by_a]]
    return FiveBarPose(
        joints=np.stack(
            [placed(zero, zero), placed(hip_x, hip_z), placed(elbow_x, elbow_z)], axis=-2
        ),
        axes=np.stack([up, hinge, hinge], axis=-2),
        toe=placed(toe_x, toe_z),
        drive=np.stack([np.stack(row, axis=-1) for row in rows], axis=-2),
    )


def settled_five_bars(legs: FiveBar, toes: Array, alike: Array) -> Array:
    """Motor angles (..., N, 3) that reach toes (..., N, 3), elbows as at angles `alike`."""
    bar = legs.linkage
    reach = toes - legs.shoulder_body
    yaw = np.arctan2(reach[..., 1], reach[..., 0])
    x = np.sqrt((reach[..., :2] ** 2).sum(axis=-1)) - bar.offset
    z = reach[..., 2] - bar.axis_f
    elbows = _circles(x, z, bar.crank_f, bar.link)  # (2, 2, ...) from crank F's axis
    wanted = np.stack([np.sin(alike[..., 1]), -np.cos(alike[..., 1])])
    nearer = ((elbows - wanted[None] * bar.crank_f) ** 2).sum(axis=1)
    elbow = np.where(nearer[0] <= nearer[1], elbows[0], elbows[1])
    f = np.arctan2(elbow[0], -elbow[1])
    link = np.stack([x, z]) - elbow
    link = link / bar.link
    side = np.stack([-link[1], link[0]])
    held = elbow + bar.held_along * link + bar.held_across * side
    height = bar.axis_f - bar.axis_a
    ends = _circles(held[0], held[1] + height, bar.crank_a, bar.coupler)
    wanted = np.stack([np.sin(alike[..., 2]), -np.cos(alike[..., 2])])
    nearer = ((ends - wanted[None] * bar.crank_a) ** 2).sum(axis=1)
    end = np.where(nearer[0] <= nearer[1], ends[0], ends[1])
    a = np.arctan2(end[0], -end[1])
    angles = np.stack([yaw - legs.mount_yaw, f, a], axis=-1)
    return np.asarray(angles - 2 * np.pi * np.round((angles - alike) / (2 * np.pi)))


def _tilt(legs: FiveBar, f: Array, a: Array) -> Array:
    """Tilt of the last link: the held point is where two circles meet, on the outward side."""
    bar = legs.linkage
    elbow = np.stack([bar.crank_f * np.sin(f), bar.axis_f - bar.crank_f * np.cos(f)])
    end = np.stack([bar.crank_a * np.sin(a), bar.axis_a - bar.crank_a * np.cos(a)])
    away = end - elbow
    # From the elbow: the meeting point to the left of the way to crank A's end
    met = _circles(away[0], away[1], float(np.hypot(bar.held_along, bar.held_across)), bar.coupler)
    left = away[0] * met[0][1] - away[1] * met[0][0] > 0
    spoke = np.where(left, met[0], met[1])
    # Turned back by where the link is held, the spoke points along the link
    length = bar.held_along**2 + bar.held_across**2
    along_x = (bar.held_along * spoke[0] + bar.held_across * spoke[1]) / length
    along_z = (bar.held_along * spoke[1] - bar.held_across * spoke[0]) / length
    return np.asarray(np.arctan2(along_x, -along_z))


def _circles(x: Array, z: Array, first: float, second: float) -> Array:
    """Both points (2, 2, ...) at distance `first` from the origin and `second` from (x, z)."""
    square = x**2 + z**2
    share = (first**2 - second**2 + square) / (2 * square)
    off = np.sqrt(first**2 / square - share**2)
    foot = np.stack([share * x, share * z])
    aside = np.stack([-off * z, off * x])
    return np.stack([foot + aside, foot - aside])
