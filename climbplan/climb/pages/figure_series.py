"""Worst torque and critical friction by limb over the instants (as in Fig. 5.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from climbplan.arrays import Array
from climbplan.climb.pages.series import (
    LimbSeries,
    compute_limb_series,
    find_round_spans,
    list_drawn_labels,
)
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    build_panel_grid,
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
    style_axes,
)

MOST_ROUND_TICKS = 12
_PANEL_HEIGHT = 1.75  # [in]


def mark_rounds(ax: Axes, plan: ClimbPlan) -> None:
    """The instants' axis: rounds numbered at their middles, boundaries as fine lines."""
    rounds = find_round_spans(plan)
    stride = int(np.ceil(len(rounds) / MOST_ROUND_TICKS))
    rounds_shown = rounds[::stride]
    numbers = plan.instants.round
    ax.set_xticks([(span.first + span.last) / 2 for span in rounds_shown])
    ax.set_xticklabels([str(numbers[span.first]) for span in rounds_shown])
    ax.tick_params(axis="x", length=0)
    ax.grid(visible=False, axis="x")
    edges = [[(span.first - 0.5, 0), (span.first - 0.5, 1)] for span in rounds[1:]]
    full = ax.get_xaxis_transform()  # from foot to top
    ax.add_artist(
        LineCollection(edges, transform=full, color=palette.GRID, linewidths=0.6, zorder=0.5)
    )
    ax.set_xlim(-0.5, plan.instants.count - 0.5)


def format_rounds_label(plan: ClimbPlan) -> str:
    """Return label of the instants' axis."""
    sizes = {span.last - span.first + 1 for span in find_round_spans(plan)}
    each = f" ({sizes.pop()} instants each)" if len(sizes) == 1 else ""
    return f"round{each}"


@dataclass(frozen=True)
class _Quantity:
    """What a series figure shows."""

    heading: str
    axis: str
    value: Callable[[LimbSeries], Array]
    failure: Callable[[LimbSeries], Array]
    planned: Callable[[LimbSeries], Array]
    names: tuple[str, str, str]  # value, failure, planned
    worst: Callable[[LimbSeries, int], str]


_TORQUE = _Quantity(
    heading="Torque of the joint nearest to its limit",
    axis="|torque| [N m]",
    value=lambda s: s.torque,
    failure=lambda s: s.torque_limit,
    planned=lambda s: s.torque_planned,
    names=("planned torque", "torque limit", r"limit / $S_\tau$ of the instant"),
    worst=lambda s, k: (
        f"max {s.torque[k]:.1f} {s.joint_units[s.joint[k]]}, {s.joint_names[s.joint[k]]}"
    ),
)
_FRICTION = _Quantity(
    heading=r"Critical friction coefficient $\mu_c$",
    axis=r"$\mu_c$",
    value=lambda s: s.mu_critical,
    failure=lambda s: s.mu,
    planned=lambda s: s.mu_planned,
    names=(r"planned $\mu_c$", r"$\mu$ of the surface: slips", r"$\mu / S_\mu$ asked for"),
    worst=lambda s, k: f"max {s.mu_critical[k]:.2f}",
)


def _draw_panel(ax: Axes, plan: ClimbPlan, series: LimbSeries, limb: int, what: _Quantity) -> None:
    """One limb."""
    k = np.arange(plan.instants.count)
    value = what.value(series)
    sides = [(span.first - 0.5, span.last + 0.5) for span in series.lifted]
    bars = [[(left, 0), (left, 1), (right, 1), (right, 0)] for left, right in sides]
    full = ax.get_xaxis_transform()  # from foot to top
    ax.add_artist(
        PolyCollection(bars, transform=full, fc=palette.MUTED, alpha=0.22, lw=0, zorder=1)
    )
    ax.step(k, what.failure(series), where="mid", color=palette.FAILURE, lw=1.4, ls=(0, (5, 2)))
    ax.step(k, what.planned(series), where="mid", color=palette.REQUIRED, lw=0.8)
    marker = "o" if len(k) <= 120 else None
    ax.plot(k, value, color=palette.choose_limb_color(limb), lw=1.3, marker=marker, ms=2.2)
    style_axes(ax)
    mark_rounds(ax, plan)
    worst = int(np.argmax(value))
    where = list_drawn_labels(plan)[worst]
    draw_panel_title(ax, format_limb_name(series.name), f"{what.worst(series, worst)}: {where}")


def _draw_by_limb(plan: ClimbPlan, what: _Quantity) -> Figure:
    """Return one panel a limb, two columns, common axes."""
    series = compute_limb_series(plan)
    columns = 2
    rows = -(-len(series) // columns)
    height = 1.25 + _PANEL_HEIGHT * rows
    figure, axes = build_panel_grid(height, entries=4, rows=rows, columns=columns)
    ceiling = max(float(np.max(what.failure(s))) for s in series)
    highest = max(float(np.max(what.value(s))) for s in series)
    for limb, limb_values in enumerate(series):
        # Down the left column first: limbs of one side stand under each other.
        _draw_panel(axes[limb % rows, limb // rows], plan, limb_values, limb, what)
    for ax in axes.T.ravel()[len(series) :]:
        ax.set_visible(False)
    for column in range(columns):
        last = min(rows, len(series) - column * rows) - 1
        axes[last, column].set_xlabel(format_rounds_label(plan))
        axes[last, column].tick_params(labelbottom=True)
    for row in range(rows):
        forces = what is _TORQUE and plan.robot.slides.any()
        axes[row, 0].set_ylabel(what.axis + (", |force| [N]" if forces else ""))
    axes[0, 0].set_ylim(0, 1.08 * max(ceiling, highest))
    handles: list[Artist] = [
        Line2D([], [], color=palette.INK, lw=1.3, marker="o", ms=2.5),
        Line2D([], [], color=palette.FAILURE, lw=1.4, ls=(0, (5, 2))),
        Line2D([], [], color=palette.REQUIRED, lw=1.0),
        Patch(color=palette.MUTED, alpha=0.22, lw=0),
    ]
    draw_foot_legend(figure, handles, [*what.names, "limb lifted"])
    draw_heading(figure, what.heading, format_plain(f"{plan.name}, {plan.robot.name}"))
    return figure


def torque(plan: ClimbPlan) -> Figure:
    """Return torque of the worst joint of each limb over the instants."""
    return _draw_by_limb(plan, _TORQUE)


def friction(plan: ClimbPlan) -> Figure:
    """Return critical friction coefficient of each limb over the instants."""
    return _draw_by_limb(plan, _FRICTION)
