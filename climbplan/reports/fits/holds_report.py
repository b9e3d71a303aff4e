"""What can be gripped in a scanned wall: terrain.yaml with a panel and its holds, report.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from climbplan.reports.fits.terrain_report import FRICTION, RESULT
from climbplan.scan.holds import Grasping, Wall
from climbplan.scan.panel import holds_headline, panel_of
from climbplan.spec.yaml_source import write_yaml


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
        "# ASSUMED: friction. A scan seen from before shows no undercut.\n"
    )
    body = {"terrain": {"friction": FRICTION, "panel": panel_of(wall)}}
    (directory / RESULT).write_text(text + write_yaml(body), encoding="utf-8")
    words = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{words}\n", encoding="utf-8")
