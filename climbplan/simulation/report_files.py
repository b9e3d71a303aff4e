"""What `simulate` writes for every kind of plan: numbers, a table, figures, film and page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from matplotlib.figure import Figure

from climbplan.reports.page_parts import Card, escape, figures, pairs, policy, style
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
    return _TEMPLATE.substitute(
        policy=policy([]),
        style=style(),
        title=escape(told.title),
        badge="nothing fell or slipped" if told.good else "see events",
        badge_class="good" if told.good else "bad",
        headline=escape(told.headline),
        cards="".join(card.html() for card in told.cards),
        notes="".join(f"<p class='note'>{escape(note)}</p>" for note in told.notes),
        events=pairs(told.events) or "<tr><td>none</td></tr>",
        film=film,
        figures=figures(images),
        conditions=pairs(
            (k, str(v)) for k, v in told.report["conditions"].items() if k != "losses"
        ),
    )


_TEMPLATE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="$policy">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="generator" content="climbplan">
<link rel="icon" href="data:,">
<title>$title</title>
<style>
$style
</style>
</head>
<body>
<header>
<div class="wide">
<p class="kicker">climbplan · simulation</p>
<h1>$title</h1>
<p class="badges"><span class="badge $badge_class">$badge</span></p>
<nav aria-label="Sections">
<a href="#pictures">Pictures</a><a href="#events">Events</a><a href="#world">World</a>
</nav>
</div>
</header>
<main class="wide">
<section id="summary" aria-label="Summary">
<p class="verdict $badge_class">$headline</p>
<dl class="cards">$cards</dl>
$notes
</section>
<section id="pictures">
<h2>Pictures</h2>
$film
$figures
</section>
<section id="events">
<h2>Slips, lost contacts and falls</h2>
<table><tbody>$events</tbody></table>
</section>
<section id="world">
<h2>World</h2>
<table><caption>Conditions of the run</caption><tbody>$conditions</tbody></table>
</section>
</main>
</body>
</html>
""")
