"""The report of a dataset: report.json, figures, and the HTML page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.bookshelf.check.plan_checks import LIMITS
from climbplan.bookshelf.check.plan_checks import MEANINGS as PLACEMENTS
from climbplan.bookshelf.plan.dataset_frame import KIND
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.datasets.check.verification import MEANINGS, verify_dataset
from climbplan.datasets.motions.statistics import build_motion_values
from climbplan.datasets.pages.figures import select_figures
from climbplan.reports.page_parts import Card, Rows, Table
from climbplan.reports.page_template import (
    build_origin_rows,
    build_report_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)
from climbplan.reports.report_files import replace_non_finite, write_files
from climbplan.reports.report_files import write_values as write_report_values
from climbplan.reports.sheet import render_png
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_file import FORMAT, FORMAT_VERSION, read_dataset_file
from climbplan.store.dataset_statistics import compute_statistics
from climbplan.verification.verification import Verification

_LISTED = 40  # rows without an answer, and the costliest
_ORIGIN = ("Problem", "Parameters", "Integers")


def build_report_values(data: Dataset, verification: Verification) -> dict[str, Any]:
    """Return JSON-ready values: the root attributes of the file, the checks, and the figures."""
    report = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "climbplan_version": data.climbplan_version,
        "created": data.created,
        "name": data.name,
        "title": data.title,
        "problem": data.frame.problem,
        "parameters": len(data.frame.parameter_names),
        "integers": len(data.frame.integer_names),
        "spec": data.spec_text,
        "spec_sha256": data.spec_sha256,
        "seed": data.base_seed,
        "status": data.overall,
        "verified": verification.passed,
        **verification.scope(),
        "timings": dict(data.timings),
        "solvers": dict(data.solvers),
        "verification": [check.as_dict() for check in verification.checks],
        **compute_statistics(data),
        "motions": build_motion_values(data),
        "without_answer": [
            _build_row(data, int(k)) for k in np.flatnonzero(~data.feasible)[:_LISTED]
        ],
        "costliest": [_build_row(data, k) for k in _select_costliest(data)],
        "trivial": TRIVIAL if data.frame.kind == KIND else None,
        "units": {
            "cost.*": data.frame.objective_unit,
            "trivial": data.frame.objective_unit,
            "time.*": "s",
            "timings.*": "s",
            "costliest.*.objective": data.frame.objective_unit,
            "costliest.*.time": "s",
            "without_answer.*.time": "s",
            "motions.*.seconds": "s",
            "motions.*.cpu_planning": "s",
            "motions.*.cpu_simulation": "s",
        },
    }
    whole: dict[str, Any] = replace_non_finite(report)
    return whole


def build_report(path: Path) -> dict[str, Any]:
    """Return the report of a dataset's file as plain values, the verification made anew."""
    data = read_dataset_file(path)
    return build_report_values(data, verify_dataset(data, path))


def write_report(path: Path, directory: Path, verification: Verification | None = None) -> None:
    """Write report.json, report.html and figures/*.png of a dataset's file into a directory.

    verification: of this very file if it was made already. Raises PlanFileError for a damaged file
    and UsageError where the directory cannot be written to.
    """
    data = read_dataset_file(path)
    report = build_report_values(data, verification or verify_dataset(data, path))
    images = {name: render_png(draw()) for name, draw in select_figures(data).items()}
    report["figures"] = [f"figures/{name}.png" for name in images]
    write_files(directory, report, _build_page(report, images), images)


def write_values(path: Path, directory: Path, verification: Verification | None = None) -> None:
    """Write report.json alone: no page, no figures."""
    data = read_dataset_file(path)
    report = build_report_values(data, verification or verify_dataset(data, path))
    write_report_values(directory, {**report, "figures": []})


def _build_page(report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    meanings = {**{name: limit.meaning for name, limit in LIMITS.items()}, **PLACEMENTS, **MEANINGS}
    origin = build_origin_rows(report, {name: report[name.lower()] for name in _ORIGIN})
    unit = report["units"]["cost.*"]
    head = ("Row", "Status", f"Cost{f' [{unit}]' if unit else ''}", "Time [ms]", "Remark")
    trivial_cost = report["trivial"]
    costly = [
        row
        for row in report["costliest"]
        if trivial_cost is None or row["objective"] > trivial_cost
    ]
    rows_listed = [*report["without_answer"], *costly]
    above = "" if trivial_cost is None else f" above {trivial_cost:g} {unit}"
    tables: dict[str, Rows] = {
        "Solvers": [(name, str(version)) for name, version in report["solvers"].items()],
        "Motions by robot and scene": [
            (
                f"{entry['robot']}, {entry['scene']}",
                (
                    f"{entry['planned']} of {entry['rows']} planned, {entry['usable']} usable, "
                    f"{entry['cpu_planning'] + entry['cpu_simulation']:.1f} s of CPU each"
                ),
            )
            for entry in report["motions"]
        ],
        "Reasons of rows without an answer": [
            (reason, f"{rows} rows") for reason, rows in report["reasons"].items()
        ],
        "Dataset": origin,
    }
    return fill(
        "dataset.html",
        **build_report_fields(report, "dataset", _build_cards(report), images, report["status"]),
        **build_verification_fields(
            report, meanings, "Everything is computed again from the stored rows."
        ),
        **build_run_fields(report, tables, "this dataset was made from"),
        pictures_note="Outcomes, times and costs of all rows; then the costliest.",
        table_note=f"Those without an answer, then the costliest{above}; all are in the file.",
        table=Table.of(head, map(_build_cells, rows_listed)),
    )


def _build_cards(report: Mapping[str, Any]) -> Iterator[Card]:
    rows, cost, time = report["rows"], report["cost"], report["time"]
    unit = f" {report['units']['cost.*']}" if report["units"]["cost.*"] else ""
    optimal = f"{rows.get('optimal', 0)} proved optimal"
    yield Card("Rows answered", f"{rows['answered']} of {rows['count']}", optimal)
    yield Card("Limit reached", str(rows.get("limit", 0)))
    yield Card("Failed", str(rows.get("failed", 0)))
    if cost["mean"] is not None:
        yield Card("Mean cost", f"{cost['mean']:.4g}{unit}", f"median {cost['median']:.4g}")
    if time["median"] is not None:
        worst = f"99 % {1e3 * time['most99']:.3g} ms, worst {1e3 * time['largest']:.3g} ms"
        yield Card("Median time", f"{1e3 * time['median']:.3g} ms", worst)
    strategies = report["strategies"]
    once = f"{strategies['seen_once']} of them in one row"
    yield Card("Different strategies", str(strategies["distinct"]), once)


def _build_cells(entry: Mapping[str, Any]) -> tuple[str, ...]:
    cost = "" if entry["objective"] is None else f"{entry['objective']:.4g}"
    time = f"{1e3 * entry['time']:.2f}"
    return (str(entry["row"]), entry["status"], cost, time, entry["message"])


def _select_costliest(data: Dataset) -> list[int]:
    cost = np.where(data.feasible, data.objective, -math.inf)
    order = np.argsort(-cost, kind="stable")[:_LISTED]
    return [int(k) for k in order if data.feasible[k]]


def _build_row(data: Dataset, k: int) -> dict[str, Any]:
    return {
        "row": k,
        "seed": int(data.seed[k]),
        "status": data.status[k],
        "objective": float(data.objective[k]),
        "time": float(data.time[k]),
        "message": data.message[k],
    }
