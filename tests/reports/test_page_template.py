"""The templates of pages: what is escaped, what is left out, and in which order checks stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from jinja2 import UndefinedError

from climbplan.reports import page_template
from climbplan.reports.page_parts import Card, Table, build_check_rows
from climbplan.reports.page_template import (
    build_frame_fields,
    build_run_fields,
    build_verification_fields,
    fill,
)
from climbplan.reports.unit_words import format_units

HOSTILE = "<b onclick='x'>{{ 7 * 7 }}</b>"
PAGES = Path(page_template.__file__).parent / "page"


def check(name: str, result: str = "passed") -> dict[str, Any]:
    return {
        "name": name,
        "result": result,
        "passed": result != "failed",
        "judged": result != "not judged",
        "residual": 0.0,
        "limit": 1e-6,
        "unit": "mm^2",
        "margin": "",
        "worst_at": HOSTILE,
    }


CHECKS = [
    check("file.spec_hash"),
    check("robot.spec"),
    check("force.friction"),
    check("terrain.spec", "failed"),
    check("torque.limit", "not judged"),
    check("limbs.axis_collision"),
]


def page(template: str = "dataset.html", **more: Any) -> str:
    report: dict[str, Any] = {
        "verification": CHECKS,
        "warnings": [HOSTILE],
        "timings": {},
        "spec": HOSTILE,
    }
    fields: dict[str, Any] = {
        **build_frame_fields(HOSTILE, (HOSTILE,), (HOSTILE,), False, [Card(HOSTILE, "3 mm^2")], {}),
        **build_verification_fields(report, {"force.friction": HOSTILE}),
        **build_run_fields(report, {"Solvers": [], "Plan": [(HOSTILE, HOSTILE)]}),
        "pictures_note": HOSTILE,
        "table_note": HOSTILE,
        "table": Table.of((HOSTILE, "empty"), [(HOSTILE, "")]),
    }
    return fill(template, **(fields | more))


def test_texts_are_escaped_wherever_they_stand() -> None:
    text = page()
    assert "<b onclick" not in text
    assert ">49<" not in text  # no text is a template
    assert text.count("{{ 7 * 7 }}") >= 12
    assert text.count("&lt;b onclick") >= 12


def test_a_field_that_nobody_gives_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="loop_note"):
        page("walking.html")


def test_checks_of_the_file_stand_after_what_the_robot_does() -> None:
    names = [row.name for row in build_check_rows({"verification": CHECKS}, {})]
    assert names[:2] == ["terrain.spec", "torque.limit"]  # what fails, what is not judged
    assert names[2:] == ["force.friction", "limbs.axis_collision", "file.spec_hash", "robot.spec"]
    text = page()
    places = [text.index(f"<th>{name}") for name in names]
    assert places == sorted(places)
    assert places[3] < text.index("The file, its data and its spec") < places[4]


def test_nothing_stands_empty() -> None:
    text = page()
    assert "Time by stage" not in text
    assert "Solvers" not in text
    assert "<th>empty</th>" not in text
    assert Table.of(("a", "b"), []).head == ("a", "b")


def test_exponents_are_raised() -> None:
    assert format_units("9.3e-03 mm^2, J k^-1 J^T f, x ^2") == "9.3e-03 mm², J k⁻¹ J^T f, x ^2"
    assert format_units("`optimal` costs") == "“optimal” costs"
    text = page()
    assert "3 mm²" in text
    assert "1.00e-06 mm²" in text


@pytest.mark.parametrize("name", sorted(path.name for path in PAGES.glob("*.html")))
def test_every_page_is_a_child_of_one(name: str) -> None:
    """One head, one style sheet, one table of checks: pages add their own sections."""
    text = (PAGES / name).read_text(encoding="utf-8")
    page_template._load_templates().get_template(name)  # it can be read
    assert "| safe" not in text
    if name in ("base.html", "parts.html", "inline.html"):  # the last is a replay in a notebook
        return
    if name.startswith("live"):  # of `climbplan serve`: an editor, and parts that it inserts
        return
    assert text.startswith('{% extends "base.html" %}')
    assert not {"<head", "<style", "<header", "</main", "Verification"} & set(text.split())
