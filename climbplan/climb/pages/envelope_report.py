"""The report of fitted envelopes: report.json, figures, and the HTML page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import climbplan
from climbplan.climb.envelopes.file import FORMAT, FORMAT_VERSION, count_drawn
from climbplan.climb.envelopes.run import EnvelopeRun
from climbplan.climb.pages.figure_envelopes import draw_boxes, draw_fitness
from climbplan.climb.schema.envelopes_loading import LoadedEnvelopes
from climbplan.reports.page_parts import Card, Table, format_value
from climbplan.reports.page_template import build_frame_fields, build_run_fields, fill
from climbplan.reports.report_files import replace_non_finite, write_files
from climbplan.reports.sheet import render_png

_HEAD = (
    "Method",
    "P1 feasible",
    "P1 infeasible",
    "P1 to P2 convex",
    "P1 to P2 NLP",
    "(1) meets",
    "(2) excludes",
    "(3) projects",
    "CPU",
)


def build_report(run: EnvelopeRun, loaded: LoadedEnvelopes) -> dict[str, Any]:
    """Return the report as JSON-ready values."""
    names = ["boxes"] + (["fitness"] if len(run.fitness) else [])
    whole: dict[str, Any] = replace_non_finite(
        {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "climbplan_version": climbplan.__version__,
            "name": loaded.name,
            "title": loaded.spec.title,
            "spec": loaded.text,
            "spec_sha256": loaded.sha256,
            "seed": loaded.spec.seed,
            "status": "feasible",
            "verified": False,
            "limb_names": list(run.limb_names),
            "training_fingerprint": run.fingerprint,
            "drawn": count_drawn(run),
            "validation": {f.method: asdict(f.validation) for f in run.fitted},
            "conditions": {f.method: asdict(f.conditions) for f in run.fitted},
            "seconds": {f.method: f.seconds for f in run.fitted},
            "timings": run.timings,
            "figures": [f"figures/{name}.png" for name in names],
        }
    )
    return whole


def write_report(run: EnvelopeRun, loaded: LoadedEnvelopes, directory: Path) -> dict[str, Any]:
    """Write report.json, report.html and figures/*.png into a directory, and give the report."""
    report = build_report(run, loaded)
    images = {"boxes": render_png(draw_boxes(run, loaded.name))}
    if len(run.fitness):
        images["fitness"] = render_png(draw_fitness(run.fitness, loaded.name))
    write_files(directory, report, _build_page(report, images), images)
    return report


def _build_page(report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    counts = next(iter(report["validation"].values()))
    origin = [
        ("Limbs", ", ".join(report["limb_names"])),
        ("climbplan", report["climbplan_version"]),
        ("Seed", str(report["seed"])),
        ("Training SHA-256", report["training_fingerprint"]),
        ("Spec SHA-256", report["spec_sha256"]),
    ]
    sizes = [
        (f"{data.replace('_', ' ')}, {what}", format_value(number))
        for data, numbers in report["drawn"].items()
        for what, number in numbers.items()
    ]
    return fill(
        "envelopes.html",
        **build_frame_fields(
            title=report["title"] or report["name"],
            kicker=(report["name"], "envelopes"),
            badges=(),
            good=True,
            cards=_build_cards(report),
            images=images,
        ),
        **build_run_fields(
            report, {"Terrains": sizes, "Fit": origin}, "these envelopes were fitted from"
        ),
        table_note=(
            f"On {counts['feasible_count']} feasible and {counts['infeasible_count']} infeasible "
            "held-out terrains. P1 to P2: share of the feasible ones. The theorem's conditions: "
            "(1) share of feasible terrains with a point of P in the box; (2) share of infeasible "
            "ones without a point of P but for its bilinear rows there; (3) share of P1's points "
            "whose toes carry balanced forces."
        ),
        table=Table.of(_HEAD, _build_rows(report)),
    )


def _build_cards(report: Mapping[str, Any]) -> Iterator[Card]:
    for method, row in report["validation"].items():
        shares = f"{_format_percent(row['feasible'])} / {_format_percent(row['infeasible'])}"
        yield Card(method, shares, "P1 right on feasible / infeasible terrains")


def _build_rows(report: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for method, row in report["validation"].items():
        conditions = report["conditions"][method]
        fractions = (row[key] for key in ("feasible", "infeasible", "convex", "nlp"))
        more = (conditions[key] for key in ("meets", "excludes", "projects"))
        yield (
            method,
            *(_format_percent(fraction) for fraction in (*fractions, *more)),
            f"{report['seconds'][method]:.3g} s",
        )


def _format_percent(fraction: float) -> str:
    return f"{100 * fraction:.1f} %"
