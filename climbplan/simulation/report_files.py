"""What `simulate` writes for every kind of plan: numbers, a table, figures, film and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.arrays import Array
from climbplan.reports.page_parts import Card, data_address
from climbplan.reports.page_template import fill, frame_fields
from climbplan.reports.report_files import write_files
from climbplan.reports.sheet import heading, new_figure, panel_title, plain, png
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.pictures import Picture
from climbplan.simulation.trials import Trial

RESULT = "simulation.csv"
FILM = "simulation.gif"
WORST_FILM = "worst_world.gif"
MAX_SPEED_SHARE = 1.05  # of a joint's speed limit that is let pass: one step of the simulation


@dataclass(frozen=True)
class End:
    """How the nominal run ended."""

    fall_time: float | None  # [s], None of a robot that stands to the end
    slips: int
    lost_contacts: int
    allowed: int  # slips and lost contacts together, by default
    joint_speed: float = 0.0  # largest share of a joint's speed limit, 0 where none is judged

    @property
    def too_fast(self) -> bool:
        """A joint turned faster than its motor can, beyond what a millisecond may show."""
        return self.joint_speed > MAX_SPEED_SHARE

    @property
    def good(self) -> bool:
        """Nothing fell, slipped or lost contact, and no joint was too fast."""
        stood = self.fall_time is None and not self.slips and not self.lost_contacts
        return stood and not self.too_fast

    @property
    def words(self) -> str:
        """ "stands", "stands with 2 slips and 1 lost contact", "falls at 4.2 s"."""
        if self.fall_time is not None:
            return f"falls at {self.fall_time:.2f} s"
        counts = [(self.slips, "slip"), (self.lost_contacts, "lost contact")]
        told = [f"{count} {name}{'s' * (count > 1)}" for count, name in counts if count]
        if self.too_fast:
            told.append(f"joint speeds of {100 * self.joint_speed:.0f} % of their limits")
        return f"stands with {' and '.join(told)}" if told else "stands"

    def failure(self, most: int | None) -> str:
        """Why the plan does not hold in the simulation, "" if it does.

        most: slips and lost contacts together that are let pass, None for the kind's default.
        """
        limit = self.allowed if most is None else most
        if self.fall_time is not None:
            return f"the robot {self.words}"
        if self.slips + self.lost_contacts > limit:
            return f"the robot {self.words}, {limit} together are let pass (--most-slips)"
        if self.too_fast:
            return (
                f"the robot {self.words}, which its motors do not reach; plan a slower walk "
                "(task.reference.velocity) or longer intervals (task.step)"
            )
        return ""


@dataclass(frozen=True)
class Told:
    """A simulation told: what stands in its files."""

    title: str
    headline: str
    end: End
    report: Mapping[str, Any]
    table: str  # CSV
    figures: Mapping[str, Figure]
    film: bytes | None  # animated GIF
    cards: Sequence[Card]
    events: Sequence[tuple[str, str]]  # when, what
    notes: Sequence[str]  # what is judged and what is not
    worlds: str = ""  # in how many the robot stands
    worst: tuple[str, bytes] | None = None  # of these, in words, and as an animated GIF


def write_simulation(told: Told, directory: Path) -> None:
    """Write report.json, report.html, simulation.csv, figures/ and, if there is one, the film."""
    images = {name: png(figure) for name, figure in told.figures.items()}
    write_files(directory, told.report, _page(told, images), images)
    (directory / RESULT).write_text(told.table, encoding="utf-8")
    if told.film is not None:
        (directory / FILM).write_bytes(told.film)
    if told.worst is not None:
        (directory / WORST_FILM).write_bytes(told.worst[1])


def _page(told: Told, images: Mapping[str, bytes]) -> str:
    return fill(
        "simulation.html",
        **frame_fields(
            title=told.title,
            kicker=("simulation",),
            badges=(told.end.words, *filter(None, [told.worlds])),
            good=told.end.good,
            cards=told.cards,
            images=images,
        ),
        verdict=told.headline,
        notes=told.notes,
        events=told.events,
        film=data_address(told.film, "gif") if told.film is not None else "",
        worst="" if told.worst is None else told.worst[0],
        worst_film="" if told.worst is None else data_address(told.worst[1], "gif"),
        conditions=[(k, str(v)) for k, v in told.report["conditions"].items() if k != "losses"],
    )


def spread(values: Array) -> dict[str, float | None]:
    """Median and range of finite values."""
    kept = values[np.isfinite(values)]
    if not kept.size:
        return {"median": None, "least": None, "most": None}
    return {"median": float(np.median(kept)), "least": float(kept.min()), "most": float(kept.max())}


def conditions_dict(conditions: Conditions) -> dict[str, Any]:
    """Conditions as JSON-ready values; the world, which has arrays, is told elsewhere."""
    plain = {k: v for k, v in vars(conditions).items() if k not in ("losses", "world")}
    losses = [{"limb": x.limb, "start": x.start, "duration": x.duration} for x in conditions.losses]
    return {**plain, "losses": losses}


def trial_dict(trial: Trial) -> dict[str, Any]:
    """One random run as JSON-ready values."""
    return {
        "fallen": trial.fallen,
        "time": trial.time,
        "slips": trial.slips,
        "conditions": conditions_dict(trial.conditions),
    }


def strip(pictures: Sequence[tuple[int, Picture]], times: Sequence[float], name: str) -> Figure:
    """Pictures of the run side by side."""
    figure = new_figure(2.6, entries=1)
    axes = figure.subplots(1, len(pictures), squeeze=False)[0]
    for ax, (sample, image) in zip(axes, pictures, strict=True):
        ax.imshow(image)
        ax.set_axis_off()
        panel_title(ax, f"{times[sample]:.3g} s")
    heading(figure, "The simulated run", plain(f"{name}, MuJoCo"))
    return figure
