"""The HTML pages of all kinds: templates in page/, and the parts that they share in page/parts/.

A page is its template with fields; what most pages show comes as fields from the functions here.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from string import Template
from typing import Any

from climbplan.reports.page_parts import (
    Card,
    Rows,
    check_rows,
    escape,
    figures,
    implausible_list,
    left_out_list,
    pairs,
    plain_words,
    policy,
    read_part,
    style,
    verdict,
)

Fields = dict[str, str]  # markup by field
_SHARED = ("head", "main", "summary", "checks", "run", "spec", "foot")


def fill(template: str, **fields: str) -> str:
    """The page: a template of page/ with the shared parts that it names, and its fields."""
    shared = {name: read_part(f"parts/{name}.html").removesuffix("\n") for name in _SHARED}
    return Template(Template(read_part(template)).safe_substitute(shared)).substitute(fields)


def frame_fields(
    title: str,
    kicker: Sequence[str],
    badges: Sequence[str],
    good: bool,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    scripts: Sequence[str] = (),
    data: str = "",
    colour: str = "",
    above: str = "",
    below: str = "",
) -> Fields:
    """Fields of head, summary and foot, and the pictures.

    kicker: words above the title. good: colour of the first badge and of the verdict; colour: of
    the badge alone. images: PNG files by name. scripts: run as they are; data: element before them
    that is not run. above, below: markup before the title and after the badges.
    """
    verdict_colour = "good" if good else "bad"
    return {
        "policy": policy(scripts),
        "style": style(),
        "title": escape(title),
        "kicker": " · ".join(escape(word) for word in ("climbplan", *kicker)),
        "above": above,
        "badges": _badges(badges, colour or verdict_colour) + below,
        "badge_class": verdict_colour,
        "cards": "".join(card.html() for card in cards),
        "figures": figures(images),
        "scripts": data + "".join(f"<script>{script}</script>\n" for script in scripts),
    }


def report_fields(
    report: Mapping[str, Any],
    kind: str,
    cards: Iterable[Card],
    images: Mapping[str, bytes],
    status: str,
    scripts: Sequence[str] = (),
    data: str = "",
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
        colour="part" if report["verified"] and report.get("verified_in") else "",
        above=implausible_list(report),
        below=left_out_list(report),
        good=report["verified"],
        cards=cards,
        images=images,
        scripts=scripts,
        data=data,
    )


def data_element(identifier: str, value: object) -> str:
    """JSON for scripts, which cannot end the element that it stands in."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{identifier}">{text}</script>\n'


def run_fields(
    report: Mapping[str, Any],
    tables: Mapping[str, Rows],
    spec_of: str = "this plan was made from",
) -> Fields:
    """Fields of run and spec. tables: of the run beside its times, by caption."""
    times = [(stage, f"{plain_words(spent)} s") for stage, spent in report["timings"].items()]
    shown = {"Time by stage": times, **tables}
    return {
        "run_tables": "\n".join(
            f"<table><caption>{escape(caption)}</caption><tbody>{pairs(rows)}</tbody></table>"
            for caption, rows in shown.items()
        ),
        "spec_of": escape(spec_of),
        "spec_text": escape(report["spec"]),
    }


def plan_tables(report: Mapping[str, Any], origin: Rows) -> dict[str, Rows]:
    """The run's tables of a plan."""
    return {
        "Solvers": _words(report["solvers"]),
        "Sizes": [(name, plain_words(size)) for name, size in report["sizes"].items()],
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
    warnings = "".join(f"<li>{escape(text)}</li>" for text in report.get("warnings", ()))
    return {
        "verdict": verdict(report),
        "warnings": f'<ul class="warnings">{warnings}</ul>' if warnings else "",
        "check_rows": check_rows(report, meanings),
        "checks_note": escape(note),
    }


def number_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table with a row of names above rows of cells."""
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f'<table class="numbers"><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>'


def _words(values: Mapping[str, object]) -> Rows:
    return [(name, str(value)) for name, value in values.items()]


def _badges(words: Sequence[str], colour: str) -> str:
    """A line of badges, the first one coloured; nothing without words."""
    if not words:
        return ""
    first, *others = (escape(word) for word in words)
    plain = "".join(f'<span class="badge">{word}</span>' for word in others)
    return f'<p class="badges"><span class="badge {colour}">{first}</span>{plain}</p>\n'
