"""What grippers can hold of a scan: terrain.yaml with panel or regions, report.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.reports.fits.terrain_report import FRICTION, RESULT
from climbplan.scan.body_holds import (
    find_body_holds,
    find_closed_bodies,
    format_body_regions,
    format_body_summary,
)
from climbplan.scan.holds import Grasping, find_wall_holds
from climbplan.scan.orienting import orient_to_free_space
from climbplan.scan.panel import build_panel, format_wall_summary
from climbplan.scan.raw import RawScan
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.schema.yaml_source import write_yaml

_UNITS = {"opening": "m", "depth": "m", "width": "m"}
_ABOVE = 10.0  # [m] of the place from which sheets beside closed bodies are seen


@dataclass(frozen=True)
class Graspable:
    """What was found."""

    headline: str
    report: dict[str, Any]  # key figures as JSON-ready values, SI units and degrees
    terrain: dict[str, Any]  # keys of `terrain` of a spec
    remark: str  # what is to be known of them


def find_graspable(raw: RawScan, scan: ScanSpec, grasping: Grasping, name: str) -> Graspable:
    """Return holds of a scanned wall or of closed bodies of a mesh; raises ScanError for none."""
    report = {
        "name": name,
        "file_read": scan.file,
        "opening": grasping.opening,
        "depth": grasping.depth,
    }
    if find_closed_bodies(raw).any():
        top = raw.vertices.mean(axis=0) + _ABOVE * np.array([0.0, 0.0, 1.0])
        body_holds = find_body_holds(orient_to_free_space(raw, top), scan, grasping)
        holds = [
            {
                "vertices": hold.vertices.tolist(),
                "normal": hold.normal.tolist(),
                "axis": hold.axis.tolist(),
                "undercut_deg": hold.undercut_deg,
                "width": hold.width,
            }
            for hold in body_holds
        ]
        return Graspable(
            format_body_summary(body_holds, grasping),
            {**report, "holds": holds, "units": {**_UNITS, "vertices": "m"}},
            {"regions": format_body_regions(body_holds, scan)},
            "From each face they are gripped in every direction in which both sides are.",
        )
    wall = find_wall_holds(raw, grasping)
    report |= {"angle_deg": wall.angle_deg, "turn_deg": wall.turn_deg}
    return Graspable(
        format_wall_summary(wall, grasping),
        {
            **report,
            "holds": [vars(hold) for hold in wall.holds],
            "units": {**_UNITS, "at": "m", "rise": "m", "room": "m"},
        },
        {"panel": build_panel(wall)},
        "A scan seen from before shows no undercut.",
    )


def write_holds(holds: Graspable, directory: Path) -> None:
    """Write terrain.yaml and report.json."""
    text = f"# {holds.headline}.\n# ASSUMED: friction. {holds.remark}\n"
    body = {"terrain": {"friction": FRICTION, **holds.terrain}}
    (directory / RESULT).write_text(text + write_yaml(body), encoding="utf-8")
    report_text = json.dumps(holds.report, indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{report_text}\n", encoding="utf-8")
