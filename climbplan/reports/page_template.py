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
    check_rows,
    data_address,
    plain_words,
    policy,
    style,
    verdict,
)
from climbplan.reports.unit_words import written
from climbplan.verification.level import Level

Fields = dict[str, Any]  # by name, as templates use them
_LEVEL_COLOURS = {Level.FINE: "good", Level.LOOK: "part", Level.DO_NOT_USE: "bad"}
NOTHING: Mapping[str, Markup] = MappingProxyType({})


@cache
def _templates() -> Environment:
    """The templates of page/. A field that a template names and nobody gives is an error."""
    environment = Environment(
        loader=PackageLoader("climbplan.reports", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["written"] = written
    return environment


def fill(template: str, **fields: Any) -> str:
    """The page: a template of page/ with its fields."""
    return _templates().get_template(template).render(fields)


def frame_fields(
    title: str,
    kicker: Sequence[str],
    badges: Sequence[str],
    good: bool,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    scripts: Sequence[str] = (),
    data: Mapping[str, Markup] = NOTHING,
    colour: str = "",
) -> Fields:
    """Fields of head, summary and foot, and the pictures.

    kicker: words above the title. good: colour of the first badge and of the verdict; colour: of
    the badge alone. images: PNG files by name. scripts: run as they are; data: what they
    read, as `data_element` gives it.
    """
    verdict_colour = "good" if good else "bad"
    return {
        "policy": Markup(policy(scripts)),  # its quotation marks are single, the attribute's double
        "style": Markup(style()),
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
        "images": {name: data_address(image) for name, image in images.items()},
        "data": data,
        "scripts": tuple(Markup(script) for script in scripts),
    }


def report_fields(
    report: Mapping[str, Any],
    kind: str,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    status: str,
    scripts: Sequence[str] = (),
    data: Mapping[str, Markup] = NOTHING,
) -> Fields:
    """As `frame_fields`, of a report; its badges say what it is verified in, and its status."""
    plain = "verified" if report["verified"] else "not verified"
    return frame_fields(
        title=report["title"] or report["name"],
        kicker=(report["name"], kind),
        badges=(
            report.get("badge") or plain,
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
        "level": level_words(report),
        **{name: tuple(report.get(name, ())) for name in ("implausible", "leaves_out", "fragile")},
    }


def level_words(report: Mapping[str, Any]) -> tuple[str, str, str]:
    """Title, advice and colour of a report's level; empty for reports without one."""
    if "level" not in report:
        return "", "", ""
    level = Level(report["level"])
    return level.label, report["advice"], _LEVEL_COLOURS[level]


def run_fields(
    report: Mapping[str, Any],
    tables: Mapping[str, Rows],
    spec_of: str = "this plan was made from",
) -> Fields:
    """Fields of run and spec.

    tables: of the run beside its times, by caption; those without rows are not shown.
    """
    times = [(stage, f"{plain_words(spent)} s") for stage, spent in report["timings"].items()]
    shown = {caption: tuple(rows) for caption, rows in {"Time by stage": times, **tables}.items()}
    return {
        "run_tables": {caption: rows for caption, rows in shown.items() if rows},
        "spec_of": spec_of,
        "spec_text": report["spec"],
    }


def plan_tables(report: Mapping[str, Any], origin: Rows) -> dict[str, Rows]:
    """The run's tables of a plan; sizes that count nothing are left out."""
    sizes = [(name, plain_words(size)) for name, size in report["sizes"].items()]
    return {
        "Solvers": _words(report["solvers"]),
        "Sizes": [(name, words) for name, words in sizes if words],
        "Plan": origin,
    }


def origin_rows(report: Mapping[str, Any], first: Mapping[str, object]) -> Rows:
    """What it is (`first`), and where it comes from."""
    return _words(
        {
            **first,
            "Created": report["created"],
            "climbplan": report["climbplan_version"],
            "Seed": report["seed"],
            "Spec SHA-256": report["spec_sha256"],
        }
    )


def verification_fields(
    report: Mapping[str, Any],
    meanings: Mapping[str, str],
    note: str = "Everything is recomputed from the plan file alone.",
) -> Fields:
    """Fields of summary and checks. meanings: of the checks, by name."""
    return {
        "verdict": verdict(report),
        "warnings": tuple(report.get("warnings", ())),
        "checks": check_rows(report, meanings),
        "checks_note": note,
    }


def data_element(identifier: str, value: object) -> dict[str, Markup]:
    """JSON for scripts by the element that holds it, which the text cannot end."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return {identifier: Markup(text.replace("<", "\\u003c"))}


def _words(values: Mapping[str, object]) -> Rows:
    return [(name, str(value)) for name, value in values.items()]
