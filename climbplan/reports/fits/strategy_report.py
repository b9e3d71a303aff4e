"""The report of a trained strategy: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from climbplan.arrays import IntArray
from climbplan.learning.evaluation import FIRST
from climbplan.learning.model_file import FORMAT, FORMAT_VERSION, ModelFile
from climbplan.reports.fits.figure_strategy import draw_ranks, draw_spaces
from climbplan.reports.page_parts import Card, Table, format_value
from climbplan.reports.page_template import (
    build_origin_rows,
    build_report_fields,
    build_run_fields,
    fill,
)
from climbplan.reports.report_files import replace_non_finite, write_files
from climbplan.reports.sheet import render_png

_HEAD = ("Problems", "Number", *(f"first {k}" for k in FIRST))


def build_report(stored: ModelFile) -> dict[str, Any]:
    """Return the report as JSON-ready values: root attributes of the file, and the evaluation."""
    names = ["spaces"] + (["ranks"] if "evaluation" in stored.fit else [])
    whole: dict[str, Any] = replace_non_finite(
        {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "climbplan_version": stored.climbplan_version,
            "created": stored.created,
            "name": stored.name,
            "title": stored.title,
            "kind": stored.model.kind,
            "program": stored.model.library.frame.name,
            "context": dict(stored.model.context),
            "spec": stored.spec_text,
            "spec_sha256": stored.spec_sha256,
            "seed": stored.seed,
            "status": "feasible",
            "verified": stored.verified,
            "timings": dict(stored.timings),
            "fit": dict(stored.fit),
            "figures": [f"figures/{name}.png" for name in names],
        }
    )
    return whole


def write_report(stored: ModelFile, columns: IntArray, directory: Path) -> None:
    """Write report.json, report.html and figures/*.png of a trained model into a directory.

    Args:
        stored: The model with its spec and evaluation.
        columns: Indices of the variables by which solutions are compared.
        directory: Directory to write into.

    Raises:
        UsageError: The directory cannot be written to.
    """
    report = build_report(stored)
    images = {"spaces": render_png(draw_spaces(stored.model, columns, stored.seed))}
    if "evaluation" in stored.fit:
        images["ranks"] = render_png(draw_ranks(stored.fit["evaluation"]))
    write_files(directory, report, _build_page(report, images), images)


def _build_page(report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    fit = report["fit"]
    evaluation = fit.get("evaluation")
    verdict_text = "Read back from its file, the model names the same candidates."
    if not report["verified"]:
        verdict_text = "Read back from its file, the model names other candidates."
    origin = build_origin_rows(report, {"Kind": report["kind"], "Program": report["program"]})
    tables = ("evaluation", "comparison")
    sizes = [(k.replace("_", " "), format_value(v)) for k, v in fit.items() if k not in tables]
    comparison = fit.get("comparison", {})
    compared = [(k.replace("_", " "), format_value(v)) for k, v in comparison.items()]
    return fill(
        "strategy.html",
        **build_report_fields(report, "strategy", _build_cards(fit), images, report["kind"]),
        **build_run_fields(
            report,
            {"Against the default method": compared, "Sizes": sizes, "Model": origin},
            "this model was trained from",
        ),
        verdict=" ".join([verdict_text, comparison.get("verdict", "")]).strip(),
        rank_note=_write_note(fit),
        table=Table.of(_HEAD, _build_rows(evaluation) if evaluation else ()),
    )


def _build_cards(fit: Mapping[str, Any]) -> Iterator[Card]:
    yield Card("Solved problems", f"{fit['groups']}", f"{fit['rows']} rows")
    yield Card("Strategies", f"{fit['strategies']}", "different integers and labels")
    if "clusters" in fit:
        yield Card("Clusters", f"{fit['clusters']}", f"{fit['outliers']} rows in none")
    evaluation = fit.get("evaluation")
    if evaluation:
        fraction = evaluation["within_first"]["10"]
        yield Card(
            "Among the first 10", _format_percent(fraction), f"{evaluation['problems']} held out"
        )


def _build_rows(evaluation: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for label, key, count in (
        ("all", "within_first", "problems"),
        ("non-trivial", "within_first_hard", "hard_problems"),
    ):
        if evaluation[count]:
            percentages = (_format_percent(evaluation[key][str(k)]) for k in FIRST)
            yield (label, str(evaluation[count]), *percentages)


def _write_note(fit: Mapping[str, Any]) -> str:
    if "evaluation" not in fit:
        return "Nothing was held out."
    hard = f" Non-trivial: {fit['hard_means']}." if fit["hard_means"] else ""
    return (
        "Share of problems held out whose optimal integers are among the first candidates, by a "
        f"model that was trained without them.{hard}"
    )


def _format_percent(fraction: float | None) -> str:
    return "none" if fraction is None else f"{100 * fraction:.1f} %"
