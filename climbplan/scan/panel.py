"""A scanned wall with its graspable holds, as `terrain.panel` of a spec."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.scan.holds import Grasping, Wall

_DIGITS = 4  # of a length [m]
_MARGIN = 0.05  # [m] of the panel around the scan


def format_wall_summary(wall: Wall, grasping: Grasping) -> str:
    """Return a one-line summary of the holds."""
    backs = [-hold.undercut_deg for hold in wall.holds]
    return (
        f"{len(wall.holds)} graspable spots within an opening of {1e3 * grasping.opening:.0f} mm, "
        f"{1e3 * grasping.depth:.0f} mm deep, sides leaning back {min(backs):.0f} to "
        f"{max(backs):.0f} degrees, on a wall at {wall.angle_deg:.1f} degrees"
    )


def build_panel(wall: Wall) -> dict[str, Any]:
    """Return the wall as `terrain.panel` of a spec, in its place, at its holds' depth.

    The plane of grips is that of the median hold. Others are off it by the difference of their
    `rise`
    in the report.
    """
    rise = float(np.median([hold.rise for hold in wall.holds]))
    (left, right), (low, high) = wall.extent
    return {
        "angle_deg": round(wall.angle_deg, 1),
        "heading_deg": round(wall.turn_deg, 1),
        "center": np.round(wall.center + rise * wall.normal, _DIGITS).tolist(),
        "across": [round(left - _MARGIN, _DIGITS), round(right + _MARGIN, _DIGITS)],
        "along": [round(low - _MARGIN, _DIGITS), round(high + _MARGIN, _DIGITS)],
        "holds": {
            f"H{number}": {
                "at": [round(v, _DIGITS) for v in hold.at],
                "width": round(hold.room, _DIGITS),
                "height": round(hold.room, _DIGITS),
                "axis_deg": round(hold.axis_deg, 1),
                "undercut_deg": round(hold.undercut_deg, 1),
            }
            for number, hold in enumerate(wall.holds, start=1)
        },
    }
