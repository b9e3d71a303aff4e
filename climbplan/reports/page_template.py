"""The HTML pages of all kinds: Jinja2 templates in page/, each a child of base.html.

A page is its template with fields; what most pages show comes as fields from the functions here.
Fields are values: every text is escaped by the template, and nothing here writes markup.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from climbplan.reports.page_parts import (
    Card,
    Rows,
    build_check_rows,
    build_policy,
    build_style,
    encode_data_url,
    format_value,
    summarise_verification,
)
from climbplan.reports.unit_words import format_units
from climbplan.verification.level import Level

Fields = dict[str, Any]  # by name, as templates use them
_LEVEL_COLOURS = {Level.FINE: "good", Level.LOOK: "part", Level.DO_NOT_USE: "bad"}
NOTHING: Mapping[str, Markup] = MappingProxyType({})


@cache
def _load_templates() -> Environment:
    """Return the templates of page/. A field that a template names and nobody gives is an error."""
    environment = Environment(
        loader=PackageLoader("climbplan.reports", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["written"] = format_units
    return environment


def fill(template: str, **fields: Any) -> str:
    """Return the page: a template of page/ with its fields."""
    return _load_templates().get_template(template).render(fields)


def build_frame_fields(
    title: str,
    kicker: Sequence[str],
    badges: Sequence[str],
    good: bool,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    *,
    scripts: Sequence[str] = (),
    data: Mapping[str, Markup] = NOTHING,
    colour: str = "",
) -> Fields:
    """Return fields of head, summary and foot, and the pictures.

    Args:
        title: Title of the page.
        kicker: Words above the title.
        badges: Badges next to the title, the most important first.
        good: Whether the first badge and the verdict have the colour of success.
        cards: Key figures of the summary.
        images: PNG files by name.
        scripts: JavaScript that runs as it is.
        data: What the scripts read, as `build_data_element` gives it.
        colour: Colour of the first badge: "good", "part" or "bad"; "" follows `good`.
    """
    verdict_colour = "good" if good else "bad"
    return {
        "policy": Markup(
            build_policy(scripts)
        ),  # its quotation marks are single, the attribute's double
        "style": Markup(build_style()),
        "title": title,
        "kicker": ("climbplan", *kicker),
        "badges": tuple(badges),
        "badge_colour": colour or verdict_colour,
        "verdict_colour": verdict_colour,
        "level": ("", "", ""),
        "implausible": (),
        "leaves_out": (),
        "fragile": (),
        "cards": tuple(cards),
        "images": {name: encode_data_url(image) for name, image in images.items()},
        "data": data,
        "scripts": tuple(Markup(script) for script in scripts),
    }


def build_report_fields(
    report: Mapping[str, Any],
    kind: str,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    status: str,
    *,
    scripts: Sequence[str] = (),
    data: Mapping[str, Markup] = NOTHING,
) -> Fields:
    """Return the fields of a report's frame; badges say what it is verified in, and its status.

    Args:
        report: Values of report.json.
        kind: What the page is about, above the title.
        cards: Key figures of the summary.
        images: PNG files by name.
        status: Text of the last badge.
        scripts: JavaScript that runs as it is.
        data: What the scripts read, as `build_data_element` gives it.
    """
    default_badge = "verified" if report["verified"] else "not verified"
    return build_frame_fields(
        title=report["title"] or report["name"],
        kicker=(report["name"], kind),
        badges=(
            report.get("badge") or default_badge,
            *([report["stands"]] if report.get("stands") else []),
            *(["fragile"] if report.get("fragile") else []),
            status,
        ),
        colour=_LEVEL_COLOURS.get(report.get("level", ""), ""),
        good=report["verified"],
        cards=cards,
        images=images,
        scripts=scripts,
        data=data,
    ) | {
        "level": describe_level(report),
        **{name: tuple(report.get(name, ())) for name in ("implausible", "leaves_out", "fragile")},
    }


def describe_level(report: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return title, advice and colour of a report's level; empty for reports without one."""
    if "level" not in report:
        return "", "", ""
    level = Level(report["level"])
    return level.label, report["advice"], _LEVEL_COLOURS[level]


def build_run_fields(
    report: Mapping[str, Any],
    tables: Mapping[str, Rows],
    spec_of: str = "this plan was made from",
) -> Fields:
    """Return fields of run and spec.

    Args:
        report: Values of report.json.
        tables: Tables of the run in addition to its times, by caption; those without rows are not
            shown.
        spec_of: Words that say what the spec is of.
    """
    times = [
        (stage, f"{format_value(duration)} s") for stage, duration in report["timings"].items()
    ]
    tables_by_caption = {
        caption: tuple(rows) for caption, rows in {"Time by stage": times, **tables}.items()
    }
    return {
        "run_tables": {caption: rows for caption, rows in tables_by_caption.items() if rows},
        "spec_of": spec_of,
        "spec_text": report["spec"],
    }


def build_plan_tables(report: Mapping[str, Any], origin: Rows) -> dict[str, Rows]:
    """Return the run's tables of a plan; sizes that count nothing are left out."""
    sizes = [(name, format_value(size)) for name, size in report["sizes"].items()]
    return {
        "Solvers": _build_rows(report["solvers"]),
        "Sizes": [(name, size_text) for name, size_text in sizes if size_text],
        "Plan": origin,
    }


def build_origin_rows(report: Mapping[str, Any], first: Mapping[str, object]) -> Rows:
    """Return what it is (`first`), and where it comes from."""
    return _build_rows(
        {
            **first,
            "Created": report["created"],
            "climbplan": report["climbplan_version"],
            "Seed": report["seed"],
            "Spec SHA-256": report["spec_sha256"],
        }
    )


def build_verification_fields(
    report: Mapping[str, Any],
    meanings: Mapping[str, str],
    note: str = "Everything is recomputed from the plan file alone.",
) -> Fields:
    """Return fields of summary and checks.

    Args:
        report: Values of report.json.
        meanings: What each check requires, by its name.
        note: Sentence below the table of checks.
    """
    return {
        "verdict": summarise_verification(report),
        "warnings": tuple(report.get("warnings", ())),
        "notes": tuple(report.get("notes", ())),
        "checks": build_check_rows(report, meanings),
        "checks_note": note,
    }


def build_data_element(identifier: str, value: object) -> dict[str, Markup]:
    """Return JSON for scripts by the element that holds it, which the text cannot end."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return {identifier: Markup(text.replace("<", "\\u003c"))}


def _build_rows(values: Mapping[str, object]) -> Rows:
    return [(name, str(value)) for name, value in values.items()]
