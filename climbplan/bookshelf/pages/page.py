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
    fill,
    origin_rows,
    plan_tables,
    report_fields,
    run_fields,
    verification_fields,
)


@dataclass(frozen=True)
class _Listed:
    """The page's own table: of books for one scene, of scenes for many."""

    title: str
    note: str
    table: Table


def build_page(_: ShelfPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """The page as text.

    report: as `report_dict` gives it. images: PNG files by name.
    """
    table = _books(report) if "books" in report else _scenes(report)
    origin = origin_rows(report, {"Method": report["method"], "Meaning": report["meaning"]})
    meanings = {**{name: limit.meaning for name, limit in LIMITS.items()}, **MEANINGS}
    return fill(
        "bookshelf.html",
        **report_fields(report, "bookshelf", _cards(report), images, report["status"]),
        **verification_fields(report, meanings),
        **run_fields(report, plan_tables(report, origin)),
        table_title=table.title,
        table_note=table.note,
        table=table.table,
    )


def _cards(report: Mapping[str, Any]) -> Iterator[Card]:
    scenes, time, cost = report["scenes"], report["time"], report["cost"]
    placed, total = scenes["optimal"] + scenes["feasible"], scenes["total"]
    if total == 1:
        bound = "no bound" if report["bound"] is None else f"at least {report['bound']:.4g} mm²"
        yield Card("Movement cost", f"{report['objective']:.4g} mm²", bound)
        yield Card("Stored books", str(scenes["stored_books"]))
        yield Card("Time", _milliseconds(time["largest"]))
    else:
        yield Card("Scenes placed", f"{placed} of {total}", f"{scenes['optimal']} proved optimal")
        yield Card("Proved infeasible", str(scenes["infeasible"]))
        yield Card("Without an answer", str(scenes["limit"]))
        spread = f"99 % {_milliseconds(time['most99'])}, worst {_milliseconds(time['largest'])}"
        yield Card("Median time", _milliseconds(time["median"]), spread)
        yield Card("Mean cost", _cost(cost["all"]["mean"]), "scenes with a placement")
        share = f"{scenes['nontrivial']} scenes above {cost['nontrivial_above']:g} mm²"
        yield Card("Mean non-trivial cost", _cost(cost["nontrivial"]["mean"]), share)
    overlap = report["overlap"]
    if overlap is not None:
        shown = f"{1e3 * overlap:.2g}" if overlap > 1e-9 else "0"
        yield Card("Worst overlap", f"{shown} mm", "after the insertion")
    shelf = report["shelf"]
    width = 1e3 * (shelf["right"] - shelf["left"])
    yield Card("Shelf", f"{width:.1f} mm", f"{1e3 * shelf['height']:.0f} mm clear height")


def _books(report: Mapping[str, Any]) -> _Listed:
    head = ("Book", "Height x width", "Before: x, y, angle", "After: x, y, angle", "Moved", "State")
    return _Listed(
        "Books",
        "Lengths in mm, angles in degrees, > 0 to the left; x from the middle of the shelf.",
        Table.of(head, _book_rows(report["books"])),
    )


def _book_rows(books: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    for book in books:
        before, after = book["before"], book["after"]
        moved = ""
        if before and after:
            moved = f"{1e3 * math.hypot(after[0] - before[0], after[1] - before[1]):.2f}"
        height, width = (1e3 * side for side in book["size"])
        yield (
            book["book"],
            f"{height:.0f} x {width:.0f}",
            _pose(before),
            _pose(after),
            moved,
            book["state"] or "",
        )


def _scenes(report: Mapping[str, Any]) -> _Listed:
    least = report["cost"]["nontrivial_above"]
    costly = [scene for scene in report["costliest"] if scene["objective"] > least]
    head = ("Scene", "Status", "Cost [mm^2]", "Bound [mm^2]", "Time [ms]", "Remark")
    return _Listed(
        "Scenes",
        f"Those without a placement, then the costliest above {least:g} mm^2; all are in the plan "
        "file.",
        Table.of(head, map(_scene_cells, [*report["without_placement"], *costly])),
    )


def _scene_cells(scene: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        str(scene["scene"]),
        scene["status"],
        "" if scene["objective"] is None else f"{scene['objective']:.3f}",
        "" if scene["bound"] is None else f"{scene['bound']:.3f}",
        f"{1e3 * scene['time']:.2f}",
        scene["message"],
    )


def _pose(pose: list[float] | None) -> str:
    if pose is None:
        return ""
    x, y, angle = pose
    return f"{1e3 * x:.1f}, {1e3 * y:.1f}, {math.degrees(angle):.1f}°"


def _milliseconds(seconds: float | None) -> str:
    return "unknown" if seconds is None else f"{1e3 * seconds:.3g} ms"


def _cost(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g} mm²"
