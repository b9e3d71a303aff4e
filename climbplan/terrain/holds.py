"""Holds: surfaces whose two sides the fingers of a gripper press on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.schema.terrain.panel import FLAT_DEG, HoldSpec, PanelSpec, RegionHoldSpec

PANEL = "panel"
_MIN_IN_PLANE = 1e-3  # fraction of an axis that lies in its region


@dataclass(frozen=True)
class Hold:
    """The geometry of a contact region that can be gripped.

    The gripped sides have unit normals +-cos(undercut) axis - sin(undercut) normal, out of the
    hold: an undercut hold is wider at its top, and its sides press fingers towards the surface. At
    -90 degrees both sides are the surface itself.
    """

    axis: Array  # (3,) unit, in the surface: from one finger to the other
    undercut: float  # [rad]
    orientation: Array  # (3,) rotation relative to the gripper about its x, y, z axes [rad]


@dataclass(frozen=True)
class PanelFrame:
    """Directions of a panel in the world."""

    across: Array  # (3,) unit
    up: Array  # (3,) unit, along the panel
    normal: Array  # (3,) unit, into free space


def panel_frame(panel: PanelSpec) -> PanelFrame:
    """Return the axes of a panel: with heading 0 across is x, at 90 degrees -y is out."""
    angle, heading = np.deg2rad(panel.angle_deg), np.deg2rad(panel.heading_deg)
    cos, sin = float(np.cos(angle)), float(np.sin(angle))
    x, y = float(np.cos(heading)), float(np.sin(heading))
    return PanelFrame(
        across=np.array([x, y, 0.0]),
        up=np.array([-y * cos, x * cos, sin]),
        normal=np.array([y * sin, -x * sin, cos]),
    )


def rectangle_on(
    panel: PanelSpec, across: tuple[float, float], along: tuple[float, float], off: float = 0.0
) -> Array:
    """Return corners (4, 3) of a rectangle on the panel, seen anticlockwise.

    off: distance before the panel [m].
    """
    frame = panel_frame(panel)
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    return np.array(
        [
            np.array(panel.center)
            + across[i] * frame.across
            + along[j] * frame.up
            + off * frame.normal
            for i, j in corners
        ]
    )


def hold_extent(spec: HoldSpec) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the extent of the grip's centre: from and to, across and up along the panel [m]."""
    u, v = spec.at
    return (
        (u - spec.width / 2, u + spec.width / 2),
        (v - spec.height / 2, v + spec.height / 2),
    )


def hold_of(panel: PanelSpec, spec: HoldSpec) -> Hold:
    """Return a hold of a panel."""
    frame = panel_frame(panel)
    turn = np.deg2rad(spec.axis_deg)
    return Hold(
        axis=np.cos(turn) * frame.up + np.sin(turn) * frame.across,
        undercut=float(np.deg2rad(spec.undercut_deg)),
        orientation=np.deg2rad(spec.orientation_deg),
    )


def hold_on(normal: Array, spec: RegionHoldSpec) -> Hold:
    """Return a hold of a region with that unit normal.

    Raises:
        UsageError: Its axis points along the normal.
    """
    axis = np.array(spec.axis, float)
    axis -= (axis @ normal) * normal
    length = float(np.linalg.norm(axis))
    if length < _MIN_IN_PLANE * np.linalg.norm(spec.axis):
        raise UsageError("the axis of its hold points along its normal")
    return Hold(
        axis=axis / length,
        undercut=float(np.deg2rad(spec.undercut_deg)),
        orientation=np.deg2rad(spec.orientation_deg),
    )


def flat_hold(normal: Array) -> Hold:
    """Return a plane surface as a hold: both fingers on the plane, with any axis in it."""
    reference = np.eye(3)[int(np.argmin(np.abs(normal)))]
    axis = np.cross(normal, reference)
    return Hold(axis / np.linalg.norm(axis), float(np.deg2rad(FLAT_DEG)), np.zeros(3))
