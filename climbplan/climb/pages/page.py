"""The HTML page: one file that needs nothing else, and runs no script but its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any

from climbplan.climb.pages.page_data import build_page_data
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports.page_parts import Card, build_sequence_table, read_part
from climbplan.reports.page_template import (
    build_data_element,
    build_origin_rows,
    build_plan_tables,
    build_report_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)
from climbplan.verification.check import LIMITS

_SCRIPTS = ("scene.js", "charts.js", "main.js")


def format_millimetres(span: Mapping[str, float | None]) -> str:
    """Return a span [m] in words."""
    lower, upper = span["least"], span["most"]
    if lower is None or upper is None:
        return "unknown"
    ends = [f"{round(1e3 * end, 1) + 0.0:.1f}" for end in (lower, upper)]  # + 0.0: no "-0.0"
    return f"{ends[0]} mm" if ends[0] == ends[1] else f"{ends[0]} to {ends[1]} mm"


def _format_factor(value: float | None) -> str:
    return "no load" if value is None else f"{value:.2f}"


def _build_cards(report: Mapping[str, Any]) -> Iterable[Card]:
    climb, safety, worst = report["climb"], report["safety"], report["worst_torque"]
    torque, friction, payload = safety["torque"], safety["friction"], report["load"]["payload"]
    minutes, seconds = divmod(round(climb["duration"]), 60)
    duration = f"in {minutes} min {seconds} s" if minutes else f"in {seconds} s"
    yield Card("Climb", f"{climb['height']:.2f} m up", f"{duration}, path {climb['path']:.2f} m")
    plural = "" if climb["rounds"] == 1 else "s"
    gait = f"{climb['instants']} instants, {climb['limbs']} limbs"
    yield Card("Gait", f"{climb['rounds']} round{plural}", gait)
    yield Card(
        "Least torque safety Sτ",
        _format_factor(torque["least"]),
        f"{torque['asked']:g} asked; {torque['limb']} {torque['joint']}, {torque['where']}",
    )
    yield Card(
        "Least friction safety Sμ",
        _format_factor(friction["least"]),
        f"{friction['asked']:g} asked; {friction['limb']}, {friction['where']}",
    )
    yield Card(
        "Highest joint torque",
        f"{worst['torque']:.1f} {worst['torque_unit']}",
        f"limit {worst['max_torque']:g}; {worst['limb']} {worst['joint']}, {worst['where']}",
    )
    yield Card("Payload", "unknown" if payload is None else f"{payload:g} kg")
    yield Card("Body sag", format_millimetres(report["sag"]), "below the planned pose")
    depth = format_millimetres(report["penetration"])
    yield Card("Depth of commands", depth, "of commanded toes inside their surfaces")
    yield Card("Cost", f"{report['objective']:.4g}", _describe_bound(report))


def _describe_bound(report: Mapping[str, Any]) -> str:
    text = "no bound" if report["bound"] is None else f"bound {report['bound']:.4g}"
    return text if report["gap"] is None else f"{text}, gap {100 * report['gap']:.2g} %"


def build_page(plan: ClimbPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """Return the page as text.

    report: as `build_report` gives it. images: PNG files by name that the page shows as they are.
    """
    scripts = (read_plotly_script(), "\n".join(read_part(name) for name in _SCRIPTS))
    origin = build_origin_rows(report, {"Robot": report["robot"]["name"]})
    return fill(
        "climb.html",
        **build_report_fields(
            report,
            report["robot"]["name"],
            _build_cards(report),
            images,
            report["status"],
            scripts=scripts,
            data=build_data_element("plan-data", build_page_data(plan)),
        ),
        **build_verification_fields(
            report, {name: limit.meaning for name, limit in LIMITS.items()}
        ),
        **build_run_fields(report, build_plan_tables(report, origin)),
        sequences=build_sequence_table(report),
        has_study=plan.study is not None,
    )


def read_plotly_script() -> str:
    """Return the charts' library from the installed plotly package."""
    path = files("plotly").joinpath("package_data").joinpath("plotly.min.js")
    text = path.read_text(encoding="utf-8")
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError("plotly.min.js cannot be written into a page as it is")
    return text
