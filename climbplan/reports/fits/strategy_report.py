"""The report of a trained strategy: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from climbplan.arrays import IntArray
from climbplan.learning.evaluation import FIRST
from climbplan.learning.model_file import FORMAT, FORMAT_VERSION, ModelFile
from climbplan.reports.fits.figure_strategy import ranks, spaces
from climbplan.reports.page_parts import Card, Table, plain_words
from climbplan.reports.page_template import (
    fill,
    origin_rows,
    report_fields,
    run_fields,
)
from climbplan.reports.report_files import finite, write_files
from climbplan.reports.sheet import png

_HEAD = ("Problems", "Number", *(f"first {k}" for k in FIRST))


def report_dict(stored: ModelFile) -> dict[str, Any]:
    """The report as JSON-ready values: root attributes of the file, and the evaluation."""
    names = ["spaces"] + (["ranks"] if "evaluation" in stored.fit else [])
    whole: dict[str, Any] = finite(
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
    """Write report.json, report.html and figures/*.png into a directory.

    columns: variables that solutions are compared by. Raises UsageError where it cannot be written.
    """
    report = report_dict(stored)
    images = {"spaces": png(spaces(stored.model, columns, stored.seed))}
    if "evaluation" in stored.fit:
        images["ranks"] = png(ranks(stored.fit["evaluation"]))
    write_files(directory, report, _page(report, images), images)


def _page(report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    fit = report["fit"]
    evaluation = fit.get("evaluation")
    told = "Read back from its file, the model names the same candidates."
    if not report["verified"]:
        told = "Read back from its file, the model names other candidates."
    origin = origin_rows(report, {"Kind": report["kind"], "Program": report["program"]})
    sizes = [(k.replace("_", " "), plain_words(v)) for k, v in fit.items() if k != "evaluation"]
    return fill(
        "strategy.html",
        **report_fields(report, "strategy", _cards(fit), images, report["kind"]),
        **run_fields(report, {"Sizes": sizes, "Model": origin}, "this model was trained from"),
        verdict=told,
        rank_note=_note(fit),
        table=Table.of(_HEAD, _rows(evaluation) if evaluation else ()),
    )


def _cards(fit: Mapping[str, Any]) -> Iterator[Card]:
    yield Card("Solved problems", f"{fit['groups']}", f"{fit['rows']} rows")
    yield Card("Strategies", f"{fit['strategies']}", "different integers and labels")
    if "clusters" in fit:
        yield Card("Clusters", f"{fit['clusters']}", f"{fit['outliers']} rows in none")
    evaluation = fit.get("evaluation")
    if evaluation:
        share = evaluation["within_first"]["10"]
        yield Card("Among the first 10", _percent(share), f"{evaluation['problems']} held out")


def _rows(evaluation: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for word, key, count in (
        ("all", "within_first", "problems"),
        ("non-trivial", "within_first_hard", "hard_problems"),
    ):
        if evaluation[count]:
            shares = (_percent(evaluation[key][str(k)]) for k in FIRST)
            yield (word, str(evaluation[count]), *shares)


def _note(fit: Mapping[str, Any]) -> str:
    if "evaluation" not in fit:
        return "Nothing was held out."
    hard = f" Non-trivial: {fit['hard_means']}." if fit["hard_means"] else ""
    return (
        "Share of problems held out whose optimal integers are among the first candidates, by a "
        f"model that was trained without them.{hard}"
    )


def _percent(share: float | None) -> str:
    return "none" if share is None else f"{100 * share:.1f} %"
