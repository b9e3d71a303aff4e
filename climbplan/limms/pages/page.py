"""The HTML page of a LIMMS plan: one self-contained file with an animated replay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from climbplan.limms.check.limits import LIMITS, MASS_LIMITS
from climbplan.limms.pages.scene import build_module_scene
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports.page_parts import Card, Table, read_part
from climbplan.reports.page_template import (
    build_data_element,
    build_origin_rows,
    build_plan_tables,
    build_report_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)
from climbplan.reports.scene_replay import build_scene_replay


def build_page(plan: LimmsPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """Build the page.

    Args:
        plan: The plan.
        report: The report, as `build_report` returns it.
        images: PNG files by name.
    """
    limits = report["limits"]
    origin = build_origin_rows(report, {"Method": report["method"], "Modes": report["sequence"]})
    return fill(
        "limms.html",
        **build_report_fields(
            report,
            "limms",
            _build_cards(report),
            images,
            report["status"],
            scripts=(read_part("replay.js"),),
            data=build_data_element("replay-data", build_scene_replay(build_module_scene(plan))),
        ),
        **build_verification_fields(
            report, {name: limit.meaning for name, limit in (LIMITS | MASS_LIMITS).items()}
        ),
        **build_run_fields(report, build_plan_tables(report, origin)),
        stages=Table.of(
            ("Stage", "From [s]", "To [s]"),
            ((s["name"], f"{s['begin']:.2f}", f"{s['end']:.2f}") for s in report["stages"]),
        ),
        loads=Table.of(
            ("Module", "Force [N]", "Torque [N m]", "Modes"),
            (
                (m["name"], f"{m['force']:.1f}", f"{m['torque']:.1f}", _format_modes(m["modes"]))
                for m in report["modules"]
            ),
        ),
        loads_note=(
            f"Largest values from the box's forces alone; limits {limits['force']:.0f} N and "
            f"{limits['torque']:.0f} N m. Held level, straight, a module needs "
            f"{limits['own_weight_torque']:.1f} N m for itself. What box and modules ask for "
            "together stands under the checks that begin with load."
        ),
    )


def _build_cards(report: Mapping[str, Any]) -> Iterator[Card]:
    """Yield the cards of the page."""
    box = report["box"]
    boxes, error_text = report["boxes"], f"{1e3 * report['objective']:.2f} mm off"
    if len(boxes) > 1:
        masses = " + ".join(f"{box_of_report['mass']:g}" for box_of_report in boxes)
        yield Card(f"{len(boxes)} boxes", f"{masses} kg", f"the worst {error_text} its goal")
    else:
        yield Card("Box", f"{box['mass']:g} kg", f"{error_text} its goal")
    yield Card("Motion", f"{report['duration']:.1f} s", f"arrives at {box['final_speed']:.2f} m/s")
    for number, box_of_report in enumerate(boxes):
        label = f"box {number}" if len(boxes) > 1 else "the box"
        yield Card(f"Modes of {label}", " → ".join(name for name, _ in box_of_report["modes"]))
    yield Card(
        "Planned in",
        f"{report['timings']['total']:.1f} s",
        f"{report['sizes']['programs']} programs",
    )
    force = max(m["force"] for m in report["modules"])
    yield Card("Largest force", f"{force:.1f} N", f"limit {report['limits']['force']:.0f} N")


def _format_modes(modes: Sequence[tuple[str, float]]) -> str:
    """Return modes with their durations, in order."""
    return ", ".join(f"{name} {seconds:.1f} s" for name, seconds in modes)
