"""The report of a dataset: report.json, figures, and the HTML page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from climbplan.bookshelf.plan_checks import LIMITS
from climbplan.bookshelf.plan_checks import MEANINGS as PLACEMENTS
from climbplan.plans.dataset import Dataset
from climbplan.plans.dataset_file import FORMAT, FORMAT_VERSION
from climbplan.plans.dataset_statistics import statistics
from climbplan.plans.verification import Verification
from climbplan.reports.figure_dataset import figure_functions
from climbplan.reports.page_parts import (
    PARTS,
    Card,
    check_rows,
    escape,
    figures,
    pairs,
    plain_words,
    policy,
    style,
    verdict,
)
from climbplan.reports.report_files import finite, write_files
from climbplan.reports.sheet import png

_LISTED = 40  # rows without an answer, and the costliest


def report_dict(data: Dataset, verification: Verification) -> dict[str, Any]:
    """JSON-ready values: the root attributes of the file, the checks, and the figures."""
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
        "timings": dict(data.timings),
        "solvers": dict(data.solvers),
        "verification": [check.as_dict() for check in verification.checks],
        **statistics(data),
        "without_answer": [_row(data, int(k)) for k in np.flatnonzero(~data.feasible)[:_LISTED]],
        "costliest": [_row(data, k) for k in _costliest(data)],
        "units": {
            "cost.*": data.frame.objective_unit,
            "time.*": "s",
            "timings.*": "s",
            "costliest.*.objective": data.frame.objective_unit,
            "costliest.*.time": "s",
            "without_answer.*.time": "s",
        },
    }
    whole: dict[str, Any] = finite(report)
    return whole


def write_report(
    data: Dataset, directory: Path, verification: Verification, meanings: Mapping[str, str]
) -> None:
    """Write report.json, report.html and figures/*.png into a directory.

    meanings: of the dataset's own checks, by name. Raises UsageError where it cannot be written.
    """
    report = report_dict(data, verification)
    images = {name: png(draw()) for name, draw in figure_functions(data).items()}
    report["figures"] = [f"figures/{name}.png" for name in images]
    write_files(directory, report, _page(report, images, meanings), images)


def _page(
    report: Mapping[str, Any], images: Mapping[str, bytes], meanings: Mapping[str, str]
) -> str:
    known = {**{name: limit.meaning for name, limit in LIMITS.items()}, **PLACEMENTS, **meanings}
    about = [
        ("Problem", report["problem"]),
        ("Parameters", report["parameters"]),
        ("Integers", report["integers"]),
        ("Created", report["created"]),
        ("climbplan", report["climbplan_version"]),
        ("Seed", report["seed"]),
        ("Spec SHA-256", report["spec_sha256"]),
    ]
    unit = report["units"]["cost.*"]
    head = ("Row", "Status", f"Cost{f' [{unit}]' if unit else ''}", "Time [ms]", "Remark")
    listed = [*report["without_answer"], *report["costliest"]]
    template = Template(PARTS.joinpath("dataset.html").read_text(encoding="utf-8"))
    return template.substitute(
        policy=policy([]),
        style=style(),
        title=escape(report["title"] or report["name"]),
        name=escape(report["name"]),
        status=escape(report["status"]),
        badge="verified" if report["verified"] else "not verified",
        badge_class="good" if report["verified"] else "bad",
        cards="".join(card.html() for card in _cards(report)),
        warnings="",
        pictures_note=escape("Outcomes, times and costs of all rows; then the costliest."),
        figures=figures(images),
        table_note=escape("Those without an answer, then the costliest; all are in the file."),
        table_head="".join(f"<th>{escape(name)}</th>" for name in head),
        table_rows="".join(_table_row(entry) for entry in listed),
        checks=check_rows(report, known),
        checks_note=escape("Everything is computed again from the stored rows."),
        verdict=verdict(report),
        timings=pairs((k, f"{plain_words(v)} s") for k, v in report["timings"].items()),
        reasons=pairs((k, f"{v} rows") for k, v in report["reasons"].items()),
        solvers=pairs((k, str(v)) for k, v in report["solvers"].items()),
        about=pairs((k, str(v)) for k, v in about),
        spec=escape(report["spec"]),
    )


def _cards(report: Mapping[str, Any]) -> Iterator[Card]:
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


def _table_row(entry: Mapping[str, Any]) -> str:
    cost = "" if entry["objective"] is None else f"{entry['objective']:.4g}"
    cells = (
        str(entry["row"]),
        entry["status"],
        cost,
        f"{1e3 * entry['time']:.2f}",
        entry["message"],
    )
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def _costliest(data: Dataset) -> list[int]:
    cost = np.where(data.feasible, data.objective, -math.inf)
    order = np.argsort(-cost, kind="stable")[:_LISTED]
    return [int(k) for k in order if data.feasible[k]]


def _row(data: Dataset, k: int) -> dict[str, Any]:
    return {
        "row": k,
        "seed": int(data.seed[k]),
        "status": data.status[k],
        "objective": float(data.objective[k]),
        "time": float(data.time[k]),
        "message": data.message[k],
    }
