"""What can be gripped in a scanned wall: terrain.yaml with a panel and its holds, report.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.reports.fits.terrain_report import FRICTION, RESULT
from climbplan.scan.holds import Grasping, Wall
from climbplan.spec.yaml_source import write_yaml

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
    """The wall as `terrain.panel` of a spec: turned about z to face -y, at its holds' depth.

    The plane in which grips are is that of the median hold; others are off it by what their `rise`
    in the report differs.
    """
    rise = float(np.median([hold.rise for hold in wall.holds]))
    (left, right), (low, high) = wall.extent
    return {
        "angle_deg": round(wall.angle_deg, 1),
        "center": np.round(_turned(wall, wall.center + rise * wall.normal), _DIGITS).tolist(),
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


def holds_report(wall: Wall, grasping: Grasping, name: str, file: str) -> dict[str, Any]:
    """Key figures as JSON-ready values, SI units and degrees."""
    return {
        "name": name,
        "file_read": file,
        "opening": grasping.opening,
        "depth": grasping.depth,
        "angle_deg": wall.angle_deg,
        "turn_deg": wall.turn_deg,
        "holds": [vars(hold) for hold in wall.holds],
        "units": {"opening": "m", "depth": "m", "at": "m", "rise": "m", "width": "m", "room": "m"},
    }


def write_holds(wall: Wall, grasping: Grasping, report: dict[str, Any], directory: Path) -> None:
    """Write terrain.yaml and report.json."""
    text = (
        f"# {holds_headline(wall, grasping)}.\n"
        f"# Turned by {-wall.turn_deg:.1f} degrees about z, so that the wall faces -y. ASSUMED: "
        "friction.\n# A scan seen from before shows no undercut.\n"
    )
    body = {"terrain": {"friction": FRICTION, "panel": panel_of(wall)}}
    (directory / RESULT).write_text(text + write_yaml(body), encoding="utf-8")
    words = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{words}\n", encoding="utf-8")


def _turned(wall: Wall, point: Any) -> Any:
    angle = -np.deg2rad(wall.turn_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ point
