"""Write the files of `simulate` for every kind of plan: numbers, table, figures, film, page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from climbplan.arrays import Array
from climbplan.reports.page_parts import Card, encode_data_url
from climbplan.reports.page_template import build_frame_fields, fill
from climbplan.reports.report_files import write_files
from climbplan.reports.sheet import (
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    render_png,
)
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.pictures import Picture
from climbplan.simulation.trials import RandomRun

RESULT = "simulation.csv"
FILM = "simulation.gif"
WORST_FILM = "worst_world.gif"
MAX_SPEED_SHARE = 1.05  # of a joint's speed limit that is let pass: one step of the simulation


@dataclass(frozen=True)
class SimulationEnd:
    """The end of the nominal run."""

    fall_time: float | None  # [s], None of a robot that stands to the end
    slips: int
    lost_contacts: int
    allowed: int  # slips and lost contacts together, by default
    stopped: str = ""  # why a robot in closed loop stopped before its goal, if it did
    joint_speed: float = 0.0  # largest share of a joint's speed limit, 0 where none is judged

    @property
    def too_fast(self) -> bool:
        """Return whether a joint exceeded its speed limit by more than one simulation step
        explains.
        """
        return self.joint_speed > MAX_SPEED_SHARE

    @property
    def good(self) -> bool:
        """Return whether nothing fell, slipped or lost contact, and no joint was too fast."""
        stood = self.fall_time is None and not self.slips and not self.lost_contacts
        return stood and not self.stopped and not self.too_fast

    @property
    def words(self) -> str:
        """ "stands", "stands with 2 slips and 1 lost contact", "falls at 4.2 s"."""
        if self.fall_time is not None:
            return f"falls at {self.fall_time:.2f} s"
        if self.stopped:
            return f"stops and stands: {self.stopped}"
        counts = [(self.slips, "slip"), (self.lost_contacts, "lost contact")]
        incidents = [f"{count} {name}{'s' * (count > 1)}" for count, name in counts if count]
        if self.too_fast:
            incidents.append(f"joint speeds of {100 * self.joint_speed:.0f} % of their limits")
        return f"stands with {' and '.join(incidents)}" if incidents else "stands"

    def failure(self, max_slips: int | None) -> str:
        """Return why the simulated plan fails, or "" if it does not.

        Args:
            max_slips: number of slips and lost contacts together that is tolerated; None means the
                default of the kind of plan.
        """
        limit = self.allowed if max_slips is None else max_slips
        if self.fall_time is not None or self.stopped:
            return f"the robot {self.words}"
        if self.slips + self.lost_contacts > limit:
            return f"the robot {self.words}, expected at most {limit} together (--most-slips)"
        if self.too_fast:
            return (
                f"the robot {self.words}, which its motors do not reach; plan a slower walk "
                "(task.reference.velocity) or longer intervals (task.dt)"
            )
        return ""


@dataclass(frozen=True)
class SimulationRecord:
    """The contents of the files of a simulation."""

    title: str
    headline: str
    end: SimulationEnd
    report: Mapping[str, Any]
    table: str  # CSV
    figures: Mapping[str, Figure]
    film: bytes | None  # animated GIF
    cards: Sequence[Card]
    events: Sequence[tuple[str, str]]  # when, what
    notes: Sequence[str]  # what is judged and what is not
    worlds: str = ""  # in how many the robot stands
    worst: tuple[str, bytes] | None = None  # of these, in words, and as an animated GIF
    # What writes plans that were made during the simulation, by file name
    plans: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)


def write_simulation(record: SimulationRecord, directory: Path) -> None:
    """Write report.json, report.html, simulation.csv, figures/, and films and plans if any."""
    images = {name: render_png(figure) for name, figure in record.figures.items()}
    write_files(directory, record.report, _render_page(record, images), images)
    (directory / RESULT).write_text(record.table, encoding="utf-8")
    if record.film is not None:
        (directory / FILM).write_bytes(record.film)
    if record.worst is not None:
        (directory / WORST_FILM).write_bytes(record.worst[1])
    for name, write_plan in record.plans.items():
        write_plan(directory / name)


def _render_page(record: SimulationRecord, images: Mapping[str, bytes]) -> str:
    return fill(
        "simulation.html",
        **build_frame_fields(
            title=record.title,
            kicker=("simulation",),
            badges=(record.end.words, *filter(None, [record.worlds])),
            good=record.end.good,
            cards=record.cards,
            images=images,
        ),
        verdict=record.headline,
        notes=record.notes,
        events=record.events,
        film=encode_data_url(record.film, "gif") if record.film is not None else "",
        worst="" if record.worst is None else record.worst[0],
        worst_film="" if record.worst is None else encode_data_url(record.worst[1], "gif"),
        conditions=[(k, str(v)) for k, v in record.report["conditions"].items() if k != "losses"],
    )


def summarise_values(values: Array) -> dict[str, float | None]:
    """Return median and range of the finite values."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"median": None, "least": None, "most": None}
    return {
        "median": float(np.median(finite)),
        "least": float(finite.min()),
        "most": float(finite.max()),
    }


def convert_conditions(conditions: Conditions) -> dict[str, Any]:
    """Convert conditions to JSON values; the world, which has arrays, is left out."""
    values = {k: v for k, v in vars(conditions).items() if k not in ("losses", "world")}
    losses = [{"limb": x.limb, "start": x.start, "duration": x.duration} for x in conditions.losses]
    return {**values, "losses": losses}


def convert_trial(trial: RandomRun) -> dict[str, Any]:
    """Convert one random run to JSON values."""
    return {
        "fallen": trial.fallen,
        "time": trial.time,
        "slips": trial.slips,
        "conditions": convert_conditions(trial.conditions),
    }


def plot_film_strip(
    pictures: Sequence[tuple[int, Picture]], times: Sequence[float], name: str
) -> Figure:
    """Draw pictures of the run side by side."""
    figure = new_figure(2.6, entries=1)
    axes = figure.subplots(1, len(pictures), squeeze=False)[0]
    for ax, (sample, image) in zip(axes, pictures, strict=True):
        ax.imshow(image)
        ax.set_axis_off()
        draw_panel_title(ax, f"{times[sample]:.3g} s")
    draw_heading(figure, "The simulated run", format_plain(f"{name}, MuJoCo"))
    return figure
