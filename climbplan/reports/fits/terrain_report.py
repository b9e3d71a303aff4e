"""The report of a scan: terrain.yaml, report.json, a page with pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from climbplan.reports import palette
from climbplan.reports.page_parts import Card, Table
from climbplan.reports.page_template import build_frame_fields, fill
from climbplan.reports.sheet import draw_heading, format_plain, new_figure, render_png
from climbplan.reports.unit_words import format_units
from climbplan.scan.study import FittedScan
from climbplan.schema.yaml_source import write_yaml

RESULT = "terrain.yaml"
_LISTED = 200  # regions in the page's table; all are in terrain.yaml
_DRAWN = 12_000  # triangles of a picture, the largest
_DIGITS = 9  # of a coordinate [m]
FRICTION = 1.0  # of terrain.yaml, to be edited
_VIEWS = ((28, -60), (28, 120), (85, -90))  # elevation, azimuth [deg]


def build_report(fitted: FittedScan, name: str) -> dict[str, Any]:
    """Return key figures as JSON-ready values, SI units."""
    vertices = fitted.raw.vertices
    return {
        "name": name,
        "file_read": fitted.scan.file,
        "triangles": len(fitted.raw.triangles),
        "area": fitted.area,
        "lower": vertices.min(axis=0).tolist(),
        "upper": vertices.max(axis=0).tolist(),
        "flatness": fitted.scan.flatness,
        "regions": len(fitted.regions),
        "regions_area": fitted.found_area,
        "notes": list(fitted.raw.notes),
        "units": {"area": "m^2", "regions_area": "m^2", "flatness": "m", "lower": "m"},
    }


def write_terrain_text(fitted: FittedScan) -> str:
    """Return the part `terrain:` of a spec, with every region."""
    scan = fitted.scan.model_dump(mode="json", exclude_unset=True)
    regions = [
        {"name": f"scan {n}", "vertices": np.round(r.vertices, _DIGITS).tolist()}
        | ({"friction": scan["friction"][r.label]} if r.label in fitted.scan.friction else {})
        for n, r in enumerate(fitted.regions, start=1)
    ]
    body = {"terrain": {"friction": FRICTION, "scan": {**scan, "fit": False}, "regions": regions}}
    return (
        f"# {fitted.headline}.\n"
        "# ASSUMED: friction. With `scan.fit: true` and no regions, each plan finds its own.\n"
        + write_yaml(body)
    )


def write_report(fitted: FittedScan, report: dict[str, Any], directory: Path, page: bool) -> None:
    """Write terrain.yaml and report.json, and the page with its pictures.

    Args:
        fitted: The scan with the regions found in it.
        report: Values of report.json, as `build_report` gives them.
        directory: Directory that exists and has no `figures` yet.
        page: Whether report.html and figures/ are written, too.
    """
    (directory / RESULT).write_text(write_terrain_text(fitted), encoding="utf-8")
    text = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
    (directory / "report.json").write_text(f"{text}\n", encoding="utf-8")
    if not page:
        return
    images = {"terrain.png": render_png(_draw_figure(fitted, report["name"]))}
    (directory / "figures").mkdir()
    for name, image in images.items():
        (directory / "figures" / name).write_bytes(image)
    (directory / "report.html").write_text(_build_page(fitted, report, images), encoding="utf-8")


def _draw_figure(fitted: FittedScan, name: str) -> Figure:
    figure = new_figure(4.6, entries=0)
    draw_heading(figure, format_plain(name), format_units(fitted.headline))
    corners = fitted.raw.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    largest = np.argsort(-np.linalg.norm(doubled, axis=1), kind="stable")[:_DRAWN]
    low, high = fitted.raw.vertices.min(axis=0), fitted.raw.vertices.max(axis=0)
    size = np.maximum(high - low, 0.05 * float((high - low).max()))
    for number, (elevation, azimuth) in enumerate(_VIEWS, start=1):
        ax: Any = figure.add_subplot(1, len(_VIEWS), number, projection="3d")
        ax.add_collection3d(
            Poly3DCollection(
                corners[largest],
                facecolor="#C9D1DA",
                edgecolor="#9AA5B1",
                linewidth=0.1,
                alpha=0.25,
            )
        )
        faces = [r.vertices + 2e-3 * r.normal for r in fitted.regions]
        colors = [palette.choose_limb_color(k) for k in range(len(faces))]
        ax.add_collection3d(
            Poly3DCollection(faces, facecolor=colors, edgecolor="white", linewidth=0.2, alpha=0.9)
        )
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        ax.set_box_aspect(size, zoom=1.15)
        ax.view_init(elevation, azimuth)
        ax.tick_params(labelsize=7)
        ax.set_xlabel("x [m]", fontsize=8)
        ax.set_ylabel("y [m]", fontsize=8)
        if elevation > 80:
            ax.set_zticks([])  # seen from above they stand on one another
    return figure


def _build_page(fitted: FittedScan, report: dict[str, Any], images: dict[str, bytes]) -> str:
    cards = [
        Card("Triangles", str(report["triangles"]), f"{report['area']:.3g} m² of surface"),
        Card("Contact regions", str(report["regions"]), f"{report['regions_area']:.3g} m²"),
        Card("Flatness", f"{1e3 * fitted.scan.flatness:g} mm", "from the raw surface, at most"),
        Card("Room for toes", f"{1e3 * fitted.scan.toe_radius:g} mm", "from edges"),
    ]
    rows = [
        (
            f"scan {n}",
            f"{1e4 * r.area:.1f}",
            ", ".join(f"{v:.3f}" for v in np.round(r.middle, 3) + 0.0),  # + 0.0: no "-0.000"
            ", ".join(f"{v:.2f}" for v in np.round(r.normal, 2) + 0.0),
            r.label,
        )
        for n, r in enumerate(fitted.regions[:_LISTED], start=1)
    ]
    notes = [("File", fitted.scan.file), *(("", note) for note in fitted.raw.notes)]
    head = ("region", "area [cm²]", "middle [m]", "normal", "material")
    return fill(
        "terrain.html",
        **build_frame_fields(
            title=report["name"],
            kicker=(report["name"], "terrain"),
            badges=(f"{report['regions']} regions",),
            good=True,
            cards=cards,
            images=images,
        ),
        verdict=f"{fitted.headline}.",
        table_note=f"The largest {len(rows)} of {report['regions']}; all are in {RESULT}.",
        table=Table.of(head, rows),
        notes=notes,
    )
