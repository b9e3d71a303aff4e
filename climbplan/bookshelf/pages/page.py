"""The HTML page of a bookshelf plan: one file that needs nothing else and runs no script."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from climbplan.bookshelf.check.plan_checks import LIMITS, MEANINGS
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.reports.page_parts import Card, Table
from climbplan.reports.page_template import (
    build_origin_rows,
    build_plan_tables,
    build_report_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)


@dataclass(frozen=True)
class _TitledTable:
    """A table with title and note: of the books of one scene, or of many scenes."""

    title: str
    note: str
    table: Table


def build_page(_: ShelfPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """Build the page as text.

    Args:
        report: the mapping of `build_report`.
        images: PNG files by name.
    """
    table = _build_book_table(report) if "books" in report else _build_scene_table(report)
    origin = build_origin_rows(
        report, {"Method": report["method"], "Formulation": report["meaning"]}
    )
    meanings = {**{name: limit.meaning for name, limit in LIMITS.items()}, **MEANINGS}
    return fill(
        "bookshelf.html",
        **build_report_fields(report, "bookshelf", _build_cards(report), images, report["status"]),
        **build_verification_fields(report, meanings),
        **build_run_fields(report, build_plan_tables(report, origin)),
        table_title=table.title,
        table_note=table.note,
        table=table.table,
    )


def _build_cards(report: Mapping[str, Any]) -> Iterator[Card]:
    scenes, time, cost = report["scenes"], report["time"], report["cost"]
    placed, total = scenes["optimal"] + scenes["feasible"], scenes["total"]
    if total == 1:
        bound = "no bound" if report["bound"] is None else f"at least {report['bound']:.4g} mm²"
        yield Card("Movement cost", f"{report['objective']:.4g} mm²", bound)
        yield Card("Stored books", str(scenes["stored_books"]))
        yield Card("Time", _format_milliseconds(time["largest"]))
    else:
        yield Card("Scenes placed", f"{placed} of {total}", f"{scenes['optimal']} proved optimal")
        yield Card("Proved infeasible", str(scenes["infeasible"]))
        yield Card("Without an answer", str(scenes["limit"]))
        percentile, worst = (_format_milliseconds(time[name]) for name in ("most99", "largest"))
        spread = f"99 % {percentile}, worst {worst}"
        yield Card("Median time", _format_milliseconds(time["median"]), spread)
        yield Card("Mean cost", _format_cost(cost["all"]["mean"]), "scenes with a placement")
        nontrivial_text = f"{scenes['nontrivial']} scenes above {cost['nontrivial_above']:g} mm²"
        yield Card(
            "Mean non-trivial cost", _format_cost(cost["nontrivial"]["mean"]), nontrivial_text
        )
    overlap = report["overlap"]
    if overlap is not None:
        overlap_text = f"{1e3 * overlap:.2g}" if overlap > 1e-9 else "0"
        yield Card("Worst overlap", f"{overlap_text} mm", "after the insertion")
    shelf = report["shelf"]
    width = 1e3 * (shelf["right"] - shelf["left"])
    yield Card("Shelf", f"{width:.1f} mm", f"{1e3 * shelf['height']:.0f} mm clear height")


def _build_book_table(report: Mapping[str, Any]) -> _TitledTable:
    head = ("Book", "Height x width", "Before: x, y, angle", "After: x, y, angle", "Moved", "State")
    return _TitledTable(
        "Books",
        "Lengths in mm, angles in degrees, > 0 to the left; x from the middle of the shelf.",
        Table.of(head, _list_book_rows(report["books"])),
    )


def _list_book_rows(books: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    for book in books:
        before, after = book["before"], book["after"]
        distance_text = ""
        if before and after:
            distance_text = f"{1e3 * math.hypot(after[0] - before[0], after[1] - before[1]):.2f}"
        height, width = (1e3 * side for side in book["size"])
        yield (
            book["book"],
            f"{height:.0f} x {width:.0f}",
            _format_pose(before),
            _format_pose(after),
            distance_text,
            book["state"] or "",
        )


def _build_scene_table(report: Mapping[str, Any]) -> _TitledTable:
    trivial_cost = report["cost"]["nontrivial_above"]
    costly = [scene for scene in report["costliest"] if scene["objective"] > trivial_cost]
    head = ("Scene", "Status", "Cost [mm^2]", "Bound [mm^2]", "Time [ms]", "Remark")
    return _TitledTable(
        "Scenes",
        f"Those without a placement, then the costliest above {trivial_cost:g} mm^2; all are in "
        "the plan file.",
        Table.of(head, map(_format_scene, [*report["without_placement"], *costly])),
    )


def _format_scene(scene: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        str(scene["scene"]),
        scene["status"],
        "" if scene["objective"] is None else f"{scene['objective']:.3f}",
        "" if scene["bound"] is None else f"{scene['bound']:.3f}",
        f"{1e3 * scene['time']:.2f}",
        scene["message"],
    )


def _format_pose(pose: list[float] | None) -> str:
    if pose is None:
        return ""
    x, y, angle = pose
    return f"{1e3 * x:.1f}, {1e3 * y:.1f}, {math.degrees(angle):.1f}°"


def _format_milliseconds(seconds: float | None) -> str:
    return "unknown" if seconds is None else f"{1e3 * seconds:.3g} ms"


def _format_cost(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g} mm²"
