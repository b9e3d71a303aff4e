"""Checks as aligned text, for terminals."""

from __future__ import annotations

from collections.abc import Sequence

from climbplan.verification.check import Check

_HEAD = ("check", "residual", "limit", "unit", "", "margin", "worst at")
_NUMERIC = {1, 2}
_MARKS = {"passed": "ok", "failed": "FAILED", "not judged": "not judged"}


def check_table(checks: Sequence[Check]) -> str:
    """A head and one line a check: failed ones first, then those that are not judged."""
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
