"""What `simulate` writes for every kind of plan: numbers, a table, figures, film and page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from climbplan.reports.page_parts import Card, escape, pairs
from climbplan.reports.page_template import fill, frame_fields
from climbplan.reports.report_files import write_files
from climbplan.reports.sheet import png

RESULT = "simulation.csv"
FILM = "simulation.gif"


@dataclass(frozen=True)
class Told:
    """A simulation told: what stands in its files."""

    title: str
    headline: str
    good: bool  # nothing fell, slipped or lost contact
    report: Mapping[str, Any]
    table: str  # CSV
    figures: Mapping[str, Figure]
    film: bytes | None  # animated GIF
    cards: Sequence[Card]
    events: Sequence[tuple[str, str]]  # when, what
    notes: Sequence[str]  # what is judged and what is not


def write_simulation(told: Told, directory: Path) -> None:
    """Write report.json, report.html, simulation.csv, figures/ and, if there is one, the film."""
    images = {name: png(figure) for name, figure in told.figures.items()}
    write_files(directory, told.report, _page(told, images), images)
    (directory / RESULT).write_text(told.table, encoding="utf-8")
    if told.film is not None:
        (directory / FILM).write_bytes(told.film)


def _page(told: Told, images: Mapping[str, bytes]) -> str:
    film = ""
    if told.film is not None:
        data = base64.b64encode(told.film).decode()
        film = f'<p><img alt="the run as a film" src="data:image/gif;base64,{data}"></p>'
    return fill(
        "simulation.html",
        **frame_fields(
            title=told.title,
            kicker=("simulation",),
            badges=("nothing fell or slipped" if told.good else "see events",),
            good=told.good,
            cards=told.cards,
            images=images,
        ),
        headline=escape(told.headline),
        notes="".join(f"<p class='note'>{escape(note)}</p>" for note in told.notes),
        events=pairs(told.events) or "<tr><td>none</td></tr>",
        film=film,
        conditions=pairs(
            (k, str(v)) for k, v in told.report["conditions"].items() if k != "losses"
        ),
    )
