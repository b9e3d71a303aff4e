"""What the checks of a plan come to: passed, failed, not judged, and what the badge says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.deprecation import current_check_name
from climbplan.errors import UnsoundPlan
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import update_store, write_json, write_text
from climbplan.verification.check import Check, LeftOut
from climbplan.verification.held import Against
from climbplan.verification.level import Level, advice_of, level_of

_NUM_OPEN = 12  # checks of a notebook's table that are seen without unfolding it
_HEAD = ("check", "residual", "limit", "unit", "", "margin", "worst at")
_NUMERIC = {1, 2}
_MARKS = {"passed": "ok", "failed": "FAILED", "not judged": "not judged"}


def format_check_table(checks: Sequence[Check]) -> str:
    """Return a head and one line a check: failed ones first, then those that are not judged."""
    rows = [
        (
            check.name,
            f"{check.residual:.1e}",
            f"{check.limit:.0e}" if check.limit else "0",
            check.unit,
            _MARKS[check.mark],
            check.margin,
            check.worst_at,
        )
        for check in sorted(checks, key=lambda check: check.rank)
    ]
    widths = [max(len(row[c]) for row in [_HEAD, *rows]) for c in range(len(_HEAD))]
    lines = [
        "  ".join(
            cell.rjust(width) if column in _NUMERIC else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in [_HEAD, *rows]
    ]
    return "\n".join(lines)


# Where one of these fails the others are not made: numbers that no robot and no task can have
SOUNDNESS = (
    "file.finite",
    "file.data",
    "robot.data",
    "terrain.data",
    "limits.data",
    "grip.data",
    "scenes.data",
)


@dataclass(frozen=True)
class Verification:
    """All checks of one plan, in the order in which they were made, and what they are worth."""

    checks: tuple[Check, ...]
    beyond: tuple[LeftOut, ...] = ()  # what the world asks of such a plan and no check looks at
    implausible: tuple[str, ...] = ()  # data and deflections that no such robot has, in words
    against: Against | None = None  # the spec that the plan was held against
    is_motion: bool = True  # whether a robot can run it; not an answer, a proof or a dataset
    risk_summary: str = ""  # "stands in 297 of 300 worlds", of plans that were judged in some

    @property
    def passed(self) -> bool:
        """Return whether every check passed that is judged."""
        return all(check.passed for check in self.checks)

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Return what the plan needs in the world and no check of it holds."""
        omissions = (check.left_out for check in self.checks)
        return tuple(dict.fromkeys([*self.beyond, *(out for out in omissions if out is not None)]))

    @property
    def badge(self) -> str:
        """The badge of the plan: "verified", "verified in its model (...)", or "not verified"."""
        if not self.passed:
            return "not verified"
        if not self.model:
            return "verified"
        return f"verified in its model ({self.model})"

    @property
    def model(self) -> str:
        """Return what the plan is verified in, "" where nothing is left out: "forward Euler"."""
        data = ["implausible data"] if self.implausible else []
        return ", ".join(dict.fromkeys([*data, *(out.model for out in self.left_out)]))

    @property
    def level(self) -> Level:
        """Return whether the plan is fine, is to be looked at, or must not be used."""
        return level_of(
            num_failed=len(self.failed),
            implausible=bool(self.implausible),
            reservations=bool(self.model or self.fragile),
        )

    @property
    def advice(self) -> str:
        """One sentence on what to do with the plan, by its level."""
        return advice_of(
            num_checks=len(self.checks),
            num_failed=len(self.failed),
            implausible=bool(self.implausible),
            fragile=bool(self.fragile),
            model=self.model,
            is_motion=self.is_motion,
        )

    @property
    def objection(self) -> str:
        """Return why the plan must not be used: its failed checks, or else implausible data; "" if
        none.

        Not "" exactly where `level` is `do_not_use`.
        """
        if not self.passed:
            return f"fails its verification: {self.headline()}"
        if self.implausible:
            return f"must not be used: implausible: {'; '.join(self.implausible)}"
        return ""

    @property
    def leaves_out(self) -> tuple[str, ...]:
        """Return what that leaves out, in short phrases with figures; `implausible` stands beside
        it.
        """
        return tuple(dict.fromkeys(out.words for out in self.left_out))

    @property
    def fragile(self) -> tuple[str, ...]:
        """Margins that the plan does not keep: where, and what there is of them; () if it does."""
        return tuple(check.fragile for check in self.checks if check.fragile)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)

    def check(self, name: str) -> Check:
        """Return the check of a name, such as "force.friction"; old names of checks work, too.

        Raises:
            KeyError: The plan has no such check; the message lists those that it has.
        """
        checks = {check.name: check for check in self.checks}
        name = current_check_name(name, checks)
        if name not in checks:
            raise KeyError(f"no check {name!r}: expected one of {', '.join(checks)}")
        return checks[name]

    @property
    def unsound(self) -> Check | None:
        """The first failed check of those without which a plan means nothing."""
        return next((check for check in self.failed if check.name in SOUNDNESS), None)

    def require_sound(self, path: Path) -> None:
        """Raise UnsoundPlan for a plan of which nothing can be computed, drawn or passed on."""
        if (worst := self.unsound) is not None:
            where = f" ({worst.worst_at})" if worst.worst_at else ""
            raise UnsoundPlan(
                f"{path}: fails its verification, {worst.name}{where}: nothing else can be made "
                "of it; `climbplan verify` lists every check"
            )

    @property
    def tightest(self) -> Check:
        """The failed check that is furthest off, else the bound of which most is used up."""
        if self.failed:
            return max(self.failed, key=lambda check: check.severity)
        return max(self.checks, key=lambda check: check.used)

    def headline(self) -> str:
        """Return one line: "31 checks, worst margin: force.friction, round 5, push 2, RF (S_mu
        1.8)".

        Without the margin where no check tells how much of its bound is used up.
        """
        worst = self.tightest
        detail = f" ({worst.margin})" if worst.margin else ""
        place = f", {worst.worst_at}" if worst.worst_at else ""
        num_unjudged = sum(not check.judged for check in self.checks)
        count = f"{len(self.checks)} checks" + (
            f", {num_unjudged} not judged" if num_unjudged else ""
        )
        if self.failed:
            first = f"{len(self.failed)} of {len(self.checks)} checks failed, worst"
        elif worst.used <= 0:
            return count
        else:
            first = f"{count}, worst margin"
        return f"{first}: {worst.name}{place}{detail}"

    def table(self) -> str:
        """Return aligned text, failed checks first, with margins and where the worst is."""
        return format_check_table(self.checks)

    def __repr__(self) -> str:
        return f"<Verification: {self.badge}; {self.level.label}; {self.headline()}>"

    def _repr_html_(self) -> str:
        """Return the table as HTML: failed checks first, then those nearest to their limits.

        Further checks than `_NUM_OPEN` that passed are folded.
        """
        rows = sorted(self.checks, key=lambda check: (check.passed, -check.used))
        cells = [
            (check.mark, check.name, f"{check.residual:.1e} {check.unit}", check.margin, place)
            for check, place in ((check, check.worst_at) for check in rows)
        ]
        names = ("", "check", "residual", "margin", "worst at")
        head = "".join(f"<th>{name}</th>" for name in names)
        lines = [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in cells]
        num_open = max(_NUM_OPEN, len(self.failed))
        first, folded = (
            f"<table><tr>{head}</tr>{''.join(rows_shown)}</table>"
            for rows_shown in (lines[:num_open], lines[num_open:])
        )
        num_folded = len(lines[num_open:])
        if num_folded:
            first += f"<details><summary>{num_folded} further checks</summary>{folded}</details>"
        summary = escape(f"{self.level.label}: {self.badge}; {self.headline()}")
        return f'<p><b>{summary}</b></p><div style="overflow-x:auto">{first}</div>'

    def scope(self) -> dict[str, Any]:
        """Return what the badge says, as plain values for JSON: of reports and of `as_dict`."""
        return {
            "level": self.level.value,
            "advice": self.advice,
            "badge": self.badge,
            "verified_in": self.model,
            "leaves_out": list(self.leaves_out),
            "implausible": list(self.implausible),
            "fragile": list(self.fragile),
            "stands": self.risk_summary,
            "verified_against": self.against.as_dict() if self.against is not None else None,
        }

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        checks = [check.as_dict() for check in self.checks]
        return {"passed": self.passed, "checks": checks, **self.scope()}


def find_stored_differences(path: Path, verification: Verification) -> tuple[str, ...]:
    """Return in words what a plan file says of its own verification and this one does not.

    Attributes that the file does not have say nothing. Raises PlanFileError for a damaged file.
    """
    computed = {
        "verified": verification.passed,
        "badge": verification.badge,
        "verified_in": verification.model,
        "leaves_out": list(verification.leaves_out),
        "fragile": list(verification.fragile),
    }
    with open_store(path) as file:
        reader = Reader(path, file)
        read: dict[str, Callable[[str, str], Any]] = {
            "verified": reader.flag,
            "badge": reader.text,
            "verified_in": reader.text,
        }
        stored = {
            name: read.get(name, reader.json)("", name)
            for name in computed
            if reader.has_attribute("", name)
        }
    return tuple(
        f"attribute `{name}` of the file is {value!r}, its verification gives {computed[name]!r}"
        for name, value in stored.items()
        if value != computed[name]
    )


def mark_verified(path: Path, verification: Verification) -> None:
    """Write the outcome into the file's attributes; the file changes whole or not at all.

    `verified`, and what it is worth: `level`, `badge`, `verified_in`, and as JSON `leaves_out`,
    `implausible` and `fragile`.
    What a plan promises of falls (`risk`) stands in it already.
    """
    with update_store(path) as file:
        file.attrs["verified"] = np.bool_(verification.passed)
        write_text(file, "level", verification.level.value)
        write_text(file, "badge", verification.badge)
        write_text(file, "verified_in", verification.model)
        write_json(file, "leaves_out", list(verification.leaves_out))
        write_json(file, "implausible", list(verification.implausible))
        write_json(file, "fragile", list(verification.fragile))
