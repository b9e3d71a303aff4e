"""Figures without pyplot: one style, no global state, one way to render them."""

from __future__ import annotations

import gc
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from climbplan.reports import palette

Plan = TypeVar("Plan")

WIDTH = 11.0  # [in]
TALLEST = 200.0  # [in]; pixels of more would not go into memory
DPI = 150
_COMPRESSION = 3  # of zlib: twice as fast as its 6, files a tenth larger
_LEGEND_COLUMNS = 9
_HEAD = 0.46  # [in] kept free above the panels for heading and note
_TITLE = 0.24  # [in] a panel's
_RIGHT = 0.12  # [in] kept free at the right
# [in] left of the panels, below them, between columns and between rows
_ROUND_AXES = (0.64, 0.42, 0.16, 0.36)
_ROUND_PICTURES = (0.08, 0.02, 0.08, 0.27)


class PanelGrid(NamedTuple):
    """A figure and its panels, an object array (rows, columns) of axes."""

    figure: Figure
    axes: np.ndarray[tuple[int, int], np.dtype[np.object_]]


def new_figure(height: float, *, entries: int) -> Figure:
    """Return an empty white figure of the common width, with room for a legend of so many entries.

    height: [in], of which no more than `TALLEST` is drawn: a plan file may claim any size.
    """
    height = min(height, TALLEST)
    foot = _compute_foot_height(entries)
    rect = (0.005, foot / height, 0.99, 1 - (foot + _HEAD) / height)
    layout = ConstrainedLayoutEngine(rect=rect)
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def build_panel_grid(
    height: float,
    *,
    entries: int,
    rows: int,
    columns: int = 1,
    axes_drawn: bool = True,
    own_heights: bool = False,
) -> PanelGrid:
    """Return a figure of equal panels on common axes, with fixed space for labels around them.

    Constrained layout would compute the same spaces at the cost of the drawing itself.

    Args:
        height: Height of the figure [in]; at most `TALLEST` is drawn.
        entries: Number of entries of the legend at the foot.
        rows: Rows of panels.
        columns: Columns of panels.
        axes_drawn: Whether panels have ticks and labels, at the left of a row and at the foot of a
            column; otherwise they are pictures that only have a title.
        own_heights: Whether panels have vertical axes of their own.
    """
    height = min(height, TALLEST)
    foot = _compute_foot_height(entries)
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left, below, across, down = _ROUND_AXES if axes_drawn else _ROUND_PICTURES
    panel_width = (WIDTH - left - _RIGHT - (columns - 1) * across) / columns
    panel_height = (height - _HEAD - _TITLE - foot - below - (rows - 1) * down) / rows
    figure.subplots_adjust(
        left=left / WIDTH,
        right=1 - _RIGHT / WIDTH,
        top=1 - (_HEAD + _TITLE) / height,
        bottom=(foot + below) / height,
        wspace=across / panel_width,
        hspace=down / panel_height,
    )
    common = axes_drawn and not own_heights
    axes = figure.subplots(rows, columns, sharex=axes_drawn, sharey=common, squeeze=False)
    return PanelGrid(figure, axes)


def _compute_foot_height(entries: int) -> float:
    """Return height [in] of the legend at the foot."""
    return 0.12 + 0.24 * -(-entries // _LEGEND_COLUMNS)


@cache
def _list_glyphs() -> frozenset[int]:
    """Return characters the figures' font can draw."""
    return frozenset(get_font(findfont("DejaVu Sans")).get_charmap())


def format_plain(text: str, max_length: int = 64) -> str:
    """Return text from a spec, safe to draw: no formulas, a box for what the font lacks, not too
    long.
    """
    glyphs = _list_glyphs()
    text_shown = "".join(c if ord(c) in glyphs else "\u25a1" for c in " ".join(text.split()))
    if len(text_shown) > max_length:
        text_shown = f"{text_shown[: max_length - 1]}…"
    return text_shown.replace("$", r"\$")


def format_limb_name(name: str) -> str:
    """Return a limb's name, short enough for a label."""
    return format_plain(name, 10)


def draw_heading(figure: Figure, text: str, note: str) -> None:
    """Draw a heading and, on the right, what is shown. Text from a spec must be plain."""
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


def draw_panel_title(ax: Axes, text: str, note: str = "") -> None:
    """Draw a panel's title, with a note on the right. Text from a spec must be plain."""
    # y fixed: no axis here has ticks above, which matplotlib would look for at each drawing.
    ax.set_title(text, loc="left", y=1.0, fontsize=10, fontweight="bold", color=palette.INK)
    ax.set_title(note, loc="right", y=1.0, fontsize=8.5, color=palette.MUTED)


def draw_foot_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str]) -> None:
    """Draw one legend along the foot of a figure."""
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


def render_png(figure: Figure) -> bytes:
    """Return the figure as a PNG file.

    Drawn once: `savefig` draws a figure with a layout engine twice, the first time for nothing.
    """
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    # White and opaque below everything: the fourth channel says nothing.
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])  # (H, W, 3)
    with io.BytesIO() as stream:
        Image.fromarray(pixels).save(
            stream, format="png", compress_level=_COMPRESSION, dpi=(figure.dpi, figure.dpi)
        )
        return stream.getvalue()


def render_figures(plan: Plan, figures: Mapping[str, Callable[[Plan], Figure]]) -> dict[str, bytes]:
    """Return PNG files of a plan's figures, by name."""
    with _suspend_garbage_collection():
        return {name: render_png(draw(plan)) for name, draw in figures.items()}


@contextmanager
def _suspend_garbage_collection() -> Iterator[None]:
    """Suspend Python's cyclic garbage collector, which frees next to nothing in figures."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
