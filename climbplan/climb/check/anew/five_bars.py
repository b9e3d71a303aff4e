"""Kinematics of five-bar legs from the lengths in a plan file, by intersections of circles.

A leg's plane has x outward from the yaw axis and z up. Angles of cranks count from straight down
towards outward. Velocities of the last link are difference quotients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.five_bar import FiveBar

_DIFFERENCE_STEP = 1e-6  # [rad]


@dataclass(frozen=True)
class FiveBarPose:
    """N legs in the body frame, with the serial joints of equal motion."""

    joints: Array  # (..., N, 3, 3) yaw axis, crank F's axis, elbow [m]
    axes: Array  # (..., N, 3, 3) unit axes there
    toe: Array  # (..., N, 3) [m]
    drive: Array  # (..., N, 3, 3) speeds about these axes by speeds of yaw, crank F, crank A


def build_five_bars(legs: FiveBar, angles: Array) -> FiveBarPose:
    """Return legs at motor angles (..., N, 3) [rad]; NaN where the linkage does not close."""
    bar = legs.linkage
    yaw = legs.mount_yaw + angles[..., 0]
    f, a = angles[..., 1], angles[..., 2]
    tilt = _compute_link_tilt(legs, f, a)
    tilt_by_f = (
        _compute_link_tilt(legs, f + _DIFFERENCE_STEP, a)
        - _compute_link_tilt(legs, f - _DIFFERENCE_STEP, a)
    ) / (2 * _DIFFERENCE_STEP)
    tilt_by_a = (
        _compute_link_tilt(legs, f, a + _DIFFERENCE_STEP)
        - _compute_link_tilt(legs, f, a - _DIFFERENCE_STEP)
    ) / (2 * _DIFFERENCE_STEP)
    hip_x, hip_z = bar.offset + 0 * f, bar.axis_f + 0 * f
    elbow_x, elbow_z = hip_x + bar.crank_f * np.sin(f), hip_z - bar.crank_f * np.cos(f)
    toe_x, toe_z = elbow_x + bar.link * np.sin(tilt), elbow_z - bar.link * np.cos(tilt)

    def place_point(x: Array, z: Array) -> Array:
        return legs.shoulder_body + np.stack([x * np.cos(yaw), x * np.sin(yaw), z], axis=-1)

    ones, zeros = np.ones_like(f), np.zeros_like(f)
    up = np.stack([zeros, zeros, ones], axis=-1)
    hinge = np.stack([np.sin(yaw), -np.cos(yaw), zeros], axis=-1)
    rows = [[ones, zeros, zeros], [zeros, ones, zeros], [zeros, tilt_by_f - 1.0, tilt_by_a]]
    return FiveBarPose(
        joints=np.stack(
            [place_point(zeros, zeros), place_point(hip_x, hip_z), place_point(elbow_x, elbow_z)],
            axis=-2,
        ),
        axes=np.stack([up, hinge, hinge], axis=-2),
        toe=place_point(toe_x, toe_z),
        drive=np.stack([np.stack(row, axis=-1) for row in rows], axis=-2),
    )


def solve_five_bars(legs: FiveBar, toes: Array, initial: Array) -> Array:
    """Return motor angles (..., N, 3) that reach toes (..., N, 3), elbows as in `initial`."""
    bar = legs.linkage
    reach = toes - legs.shoulder_body
    yaw = np.arctan2(reach[..., 1], reach[..., 0])
    x = np.sqrt((reach[..., :2] ** 2).sum(axis=-1)) - bar.offset
    z = reach[..., 2] - bar.axis_f
    elbows = _intersect_circles(x, z, bar.crank_f, bar.link)  # (2, 2, ...) from crank F's axis
    initial_direction = np.stack([np.sin(initial[..., 1]), -np.cos(initial[..., 1])])
    squared_distance = ((elbows - initial_direction[None] * bar.crank_f) ** 2).sum(axis=1)
    elbow = np.where(squared_distance[0] <= squared_distance[1], elbows[0], elbows[1])
    f = np.arctan2(elbow[0], -elbow[1])
    link = np.stack([x, z]) - elbow
    link = link / bar.link
    side = np.stack([-link[1], link[0]])
    coupler_joint = elbow + bar.held_along * link + bar.held_across * side
    height = bar.axis_f - bar.axis_a
    ends = _intersect_circles(coupler_joint[0], coupler_joint[1] + height, bar.crank_a, bar.coupler)
    initial_direction = np.stack([np.sin(initial[..., 2]), -np.cos(initial[..., 2])])
    squared_distance = ((ends - initial_direction[None] * bar.crank_a) ** 2).sum(axis=1)
    end = np.where(squared_distance[0] <= squared_distance[1], ends[0], ends[1])
    a = np.arctan2(end[0], -end[1])
    angles = np.stack([yaw - legs.mount_yaw, f, a], axis=-1)
    return np.asarray(angles - 2 * np.pi * np.round((angles - initial) / (2 * np.pi)))


def _compute_link_tilt(legs: FiveBar, f: Array, a: Array) -> Array:
    """Return the last link's tilt from the intersection of two circles, on the outward side."""
    bar = legs.linkage
    elbow = np.stack([bar.crank_f * np.sin(f), bar.axis_f - bar.crank_f * np.cos(f)])
    end = np.stack([bar.crank_a * np.sin(a), bar.axis_a - bar.crank_a * np.cos(a)])
    crank_to_elbow = end - elbow
    # From the elbow: the meeting point to the left of the way to crank A's end
    intersections = _intersect_circles(
        crank_to_elbow[0],
        crank_to_elbow[1],
        float(np.hypot(bar.held_along, bar.held_across)),
        bar.coupler,
    )
    is_left = crank_to_elbow[0] * intersections[0][1] - crank_to_elbow[1] * intersections[0][0] > 0
    spoke = np.where(is_left, intersections[0], intersections[1])
    # Turned back by where the link is held, the spoke points along the link
    length = bar.held_along**2 + bar.held_across**2
    along_x = (bar.held_along * spoke[0] + bar.held_across * spoke[1]) / length
    along_z = (bar.held_along * spoke[1] - bar.held_across * spoke[0]) / length
    return np.asarray(np.arctan2(along_x, -along_z))


def _intersect_circles(x: Array, z: Array, first: float, second: float) -> Array:
    """Return both points (2, 2, ...) at `first` from the origin and `second` from (x, z)."""
    square = x**2 + z**2
    fraction = (first**2 - second**2 + square) / (2 * square)
    half_chord = np.sqrt(first**2 / square - fraction**2)
    chord_middle = np.stack([fraction * x, fraction * z])
    perpendicular = np.stack([-half_chord * z, half_chord * x])
    return np.stack([chord_middle + perpendicular, chord_middle - perpendicular])
