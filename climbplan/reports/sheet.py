"""Figures without pyplot: one style, no global state, one way to render them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import cache

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.layout_engine import ConstrainedLayoutEngine

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.reports import palette

WIDTH = 11.0  # [in]
DPI = 150
_LEGEND_COLUMNS = 9
_HEAD = 0.46  # [in] kept free above the panels for heading and note


def new_figure(height: float, *, entries: int) -> Figure:
    """An empty white figure of the common width, with room for a legend of so many entries.

    height: [in].
    """
    foot = 0.12 + 0.24 * -(-entries // _LEGEND_COLUMNS)
    rect = (0.005, foot / height, 0.99, 1 - (foot + _HEAD) / height)
    layout = ConstrainedLayoutEngine(rect=rect)
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


@cache
def _glyphs() -> frozenset[int]:
    """Characters the figures' font can draw."""
    return frozenset(get_font(findfont("DejaVu Sans")).get_charmap())


def plain(text: str, most: int = 64) -> str:
    """Text from a spec, safe to draw: no formulas, a box for what the font lacks, not too long."""
    known = _glyphs()
    shown = "".join(c if ord(c) in known else "\u25a1" for c in " ".join(text.split()))
    if len(shown) > most:
        shown = f"{shown[: most - 1]}…"
    return shown.replace("$", r"\$")


def limb_name(name: str) -> str:
    """A limb's name, short enough for a label."""
    return plain(name, 10)


def drawn_labels(plan: ClimbPlan) -> tuple[str, ...]:
    """Where every instant stands in the gait, as it may be drawn."""
    names = tuple(limb_name(name) for name in plan.robot.limb_names)
    return tuple(plan.instants.label(k, names) for k in range(plan.instants.count))


def heading(figure: Figure, text: str, note: str) -> None:
    """A heading and, on the right, what is drawn. Text from a spec must be `plain`."""
    y = 1 - 0.14 / figure.get_figheight()
    figure.text(0.012, y, text, fontsize=12.5, fontweight="bold", va="top", color=palette.INK)
    figure.text(0.988, y, note, fontsize=9, va="top", ha="right", color=palette.MUTED)


def style_axes(ax: Axes) -> None:
    """Light frame and grid, readable ticks."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(palette.MUTED)
    ax.tick_params(colors=palette.MUTED, labelsize=8.5, labelcolor=palette.INK, length=3)
    ax.xaxis.label.set(color=palette.INK, fontsize=9.5)
    ax.yaxis.label.set(color=palette.INK, fontsize=9.5)
    ax.grid(color=palette.GRID, linewidth=0.5)
    ax.set_axisbelow(True)


def panel_title(ax: Axes, text: str, note: str = "") -> None:
    """What a panel shows, with a note on the right. Text from a spec must be `plain`."""
    ax.set_title(text, loc="left", fontsize=10, fontweight="bold", color=palette.INK)
    ax.set_title(note, loc="right", fontsize=8.5, color=palette.MUTED)


def foot_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str]) -> None:
    """One legend along the foot of a figure."""
    # A leading blank keeps matplotlib from hiding names that begin with an underscore.
    figure.legend(
        list(handles),
        [f" {label}" for label in labels],
        loc="lower center",
        ncols=min(len(handles), _LEGEND_COLUMNS),
        frameon=False,
        fontsize=9,
        handletextpad=0.3,
        columnspacing=1.4,
        bbox_to_anchor=(0.5, 0.0),
    )


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    with io.BytesIO() as stream:
        figure.savefig(stream, format="png")
        return stream.getvalue()
