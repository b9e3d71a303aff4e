"""What pages of all kinds of plan are made of, as values; page/parts.html has their markup."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from climbplan.reports import palette

Rows = Iterable[tuple[str, str]]
# Checks of the file itself, its data and its spec: told after what the robot does
_OF_THE_FILE = ("file.", "robot.", "terrain.", "limits.")


def read_part(name: str) -> str:
    """Return the text of a file in page/."""
    return files("climbplan.reports").joinpath("page").joinpath(name).read_text(encoding="utf-8")


def build_policy(scripts: Iterable[str]) -> str:
    """Return a content policy that allows these inline scripts, no others, and no network."""
    digests = (hashlib.sha256(text.encode()).digest() for text in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(d).decode()}'" for d in digests) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'"
    )


@dataclass(frozen=True)
class Card:
    """One key figure: what it is, its value, and where or of what."""

    label: str
    value: str
    detail: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a row of names above rows of cells."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @classmethod
    def of(cls, head: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
        """Return a table of any iterables; columns in which nothing stands are left out."""
        names, cells = tuple(head), tuple(tuple(row) for row in rows)
        filled_columns = [k for k in range(len(names)) if not cells or any(row[k] for row in cells)]
        return cls(
            tuple(names[k] for k in filled_columns),
            tuple(tuple(row[k] for k in filled_columns) for row in cells),
        )


@dataclass(frozen=True)
class CheckRow:
    """One check as the page shows it."""

    mark: str  # "failed", "not judged" or "passed"
    name: str
    meaning: str
    residual: str  # with unit
    limit: str  # with unit
    margin: str  # and where it is least

    @property
    def of_the_file(self) -> bool:
        """Return whether it is about the file, its data and its spec, not about what the robot
        does.
        """
        return self.name.startswith(_OF_THE_FILE)


def build_check_rows(report: Mapping[str, Any], meanings: Mapping[str, str]) -> list[CheckRow]:
    """Return verification, failed checks first, those of the file last. meanings: of checks by
    name.
    """
    rows = [_build_check_row(check, meanings) for check in report["verification"]]
    order = ("failed", "not judged", "passed")
    return sorted(rows, key=lambda row: (order.index(row.mark), row.of_the_file))


def _build_check_row(check: Mapping[str, Any], meanings: Mapping[str, str]) -> CheckRow:
    unit = f" {check['unit']}" if check["unit"] else ""
    return CheckRow(
        mark=check["result"],
        name=check["name"],
        meaning=meanings.get(check["name"], ""),
        residual=_format_number(check["residual"]) + unit,
        limit=_format_number(check["limit"]) + unit,
        margin=" · ".join(text for text in (check["margin"], check["worst_at"]) if text),
    )


def _format_number(number: float | None) -> str:
    return "not finite" if number is None else f"{number:.2e}" if number else "0"


def build_sequence_table(report: Mapping[str, Any]) -> Table | None:
    """Return all contact sequences that a search found; None where there was none."""
    sequences = report.get("sequences")
    if not sequences:
        return None

    def factor(value: float | None) -> str:
        return "no load" if value is None else f"{value:.2f}"

    return Table.of(
        ("sequence", "cost", "Sτ", "Sμ", "outcome"),
        (
            (
                row["name"],
                f"{row['cost']:.5f}",
                factor(row["safety_torque"]),
                factor(row["safety_friction"]),
                row["outcome"],
            )
            for row in sequences
        ),
    )


def summarise_verification(report: Mapping[str, Any]) -> str:
    """Return how the verification went, in a sentence."""
    checks = report["verification"]
    failed = [check["name"] for check in checks if not check["passed"]]
    unjudged = [check["name"] for check in checks if check["passed"] and not check["judged"]]
    if not failed and unjudged:
        judged = len(checks) - len(unjudged)
        return f"All {judged} checks passed that are judged; not judged: {', '.join(unjudged)}."
    if not failed:
        return f"All {len(checks)} checks passed."
    return f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}."


def format_value(value: object) -> str:
    """Return a size or count of any shape as words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {format_value(v)}" for k, v in value.items())
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(format_value(v) for v in value)
    return str(value)


def encode_data_url(image: bytes, kind: str = "png") -> str:
    """Return a picture as the address of itself."""
    return f"data:image/{kind};base64,{base64.b64encode(image).decode()}"


def build_style() -> str:
    """Return the style sheet with the colours of the figures."""
    colors = {
        "failure": palette.FAILURE,
        "force": palette.FORCE,
        "surface": palette.SURFACE,
        "obstacle": palette.OBSTACLE,
    }
    variables = "".join(f"--{name}:{color};" for name, color in colors.items())
    return f":root{{{variables}}}\n" + read_part("style.css")
