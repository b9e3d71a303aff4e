"""A scanned wall with what grippers can hold on it, as `terrain.panel` of a spec."""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.scan.holds import Grasping, Wall

_DIGITS = 4  # of a length [m]
_MARGIN = 0.05  # [m] of the panel around the scan


def holds_headline(wall: Wall, grasping: Grasping) -> str:
    """What was found, in a line."""
    backs = [-hold.undercut_deg for hold in wall.holds]
    return (
        f"{len(wall.holds)} graspable spots within an opening of {1e3 * grasping.opening:.0f} mm, "
        f"{1e3 * grasping.depth:.0f} mm deep, sides leaning back {min(backs):.0f} to "
        f"{max(backs):.0f} degrees, on a wall at {wall.angle_deg:.1f} degrees"
    )


def panel_of(wall: Wall) -> dict[str, Any]:
    """The wall as `terrain.panel` of a spec, where it stands, at its holds' depth.

    The plane in which grips are is that of the median hold; others are off it by what their `rise`
    in the report differs.
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
