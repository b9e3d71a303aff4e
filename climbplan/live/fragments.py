"""Parts of the live page that show plans: outcome and checks, two plans compared, replays."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from climbplan.api.kinds import identify_kind
from climbplan.api.limit_kinds import LIMIT_KINDS
from climbplan.live.planning import Run
from climbplan.reports.notebook import build_replay_page, thin_scene
from climbplan.reports.page_parts import build_check_rows, format_value
from climbplan.reports.page_template import describe_level, fill

REPLAY_HEIGHT = 380  # [pixels]
_FIGURES = {  # of both plans, by their key in the report
    "badge": "badge",
    "status": "status",
    "objective": "cost",
    "bound": "lower bound of the cost",
    "gap": "relative gap",
}


def build_outcome(run: Run) -> str:
    """Return the outcome of a complete run as HTML: level, summary, and the table of checks.

    Of a run without a plan it says why there is none, what conflicts, and what would help.
    """
    answer = run.answer
    return fill(
        "live_outcome.html",
        level=describe_level(answer),
        badge=str(answer.get("badge", "")),
        fragile=tuple(answer.get("fragile", ())),
        warnings=tuple(answer.get("warnings", ())),
        notes=tuple(answer.get("notes", ())),
        failure=_describe_failure(run),
        lines=tuple(run.lines),
        checks=build_check_rows(answer, _find_meanings(run)) if "verification" in answer else (),
        folder=f"outputs/live_{run.number}" if run.plan_path is not None else "",
    )


def _describe_failure(run: Run) -> dict[str, Any] | None:
    """Return message and remedies of a run that ended without a plan; None of one with a plan."""
    if run.is_cancelled:
        return {"message": "cancelled", "remedies": ()}
    if run.exit_code == 0:
        return None
    answer = run.answer
    remedies = tuple(
        f"{remedy['words']} (set {remedy['key']})" if remedy["key"] else remedy["words"]
        for remedy in answer.get("remedies", ())
    )
    message = str(answer.get("message", "")) or f"the planner ended with exit code {run.exit_code}"
    return {"message": message, "remedies": remedies}


def build_comparison(first: Run, second: Run) -> str:
    """Return two plans side by side as HTML: key figures, checks, and what their specs change."""
    meanings = _find_meanings(first) | _find_meanings(second)
    first_rows, second_rows = (_rows_by_name(run, meanings) for run in (first, second))
    telling = {
        check["name"]
        for run in (first, second)
        for check in run.answer.get("verification", ())
        if check["margin"] or not check["passed"]
    }
    return fill(
        "live_comparison.html",
        numbers=(first.number, second.number),
        figures=_compare_figures(first, second),
        checks=[
            (name, meanings[name], first_rows.get(name), second_rows.get(name))
            for name in dict.fromkeys([*first_rows, *second_rows])
            if name in telling
        ],
        num_others=len(meanings) - len(telling),
        changes=_compare_specs(first.spec_text, second.spec_text),
    )


def build_replay(run: Run) -> str:
    """Return a self-contained page that replays the plan of a run.

    Raises:
        UsageError: the plan has no geometry.
        PlanFileError: its file is gone or damaged.
    """
    assert run.plan_path is not None
    scene = identify_kind(run.plan_path).read_scene(run.plan_path)
    return build_replay_page(thin_scene(scene), REPLAY_HEIGHT)


def _find_meanings(run: Run) -> dict[str, str]:
    kind = LIMIT_KINDS[run.kind]
    names = (check["name"] for check in run.answer.get("verification", ()))
    return {name: kind.describe_check(name) for name in names}


def _rows_by_name(run: Run, meanings: Mapping[str, str]) -> dict[str, Any]:
    if "verification" not in run.answer:
        return {}
    return {row.name: row for row in build_check_rows(run.answer, meanings)}


def _compare_figures(first: Run, second: Run) -> list[tuple[str, str, str]]:
    """Return rows of name and both values; figures that neither plan has are left out."""
    reports = first.answer, second.answer
    rows = [
        ("level", describe_level(reports[0])[0], describe_level(reports[1])[0]),
        *(
            (name, _format_figure(reports[0].get(key)), _format_figure(reports[1].get(key)))
            for key, name in _FIGURES.items()
        ),
        ("time", _format_seconds(first.seconds), _format_seconds(second.seconds)),
    ]
    return [row for row in rows if any(row[1:])]


def _format_figure(value: object) -> str:
    return "" if value is None else format_value(value)


def _format_seconds(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.1f} s"


def _compare_specs(first: str, second: str) -> list[tuple[str, str]]:
    """Return the lines in which two specs differ, each with "removed" or "added"."""
    marks = {"-": "removed", "+": "added"}
    lines = difflib.unified_diff(first.splitlines(), second.splitlines(), lineterm="", n=0)
    return [
        (marks[line[0]], line[1:])
        for number, line in enumerate(lines)
        if number >= 2 and line[0] in marks
    ]
