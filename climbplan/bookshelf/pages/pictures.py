"""Scenes as seen from the front: before and after the insertion, and a gallery of many.

Books are coloured by their state, the inserted one is hatched, moved books leave their old outline
and an arrow behind. Figures without pyplot; lengths on the axes in mm.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch, Polygon, Rectangle
from matplotlib.patheffects import Normal, Stroke

from climbplan.arrays import Array, IntArray
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer
from climbplan.bookshelf.scene.rectangles import compute_corners
from climbplan.bookshelf.scene.shelf_scene import BookState, Shelf, ShelfScene, state_label

# Distinguishable with any common colour blindness (after Okabe and Ito): both leans, both flats.
COLORS = {
    BookState.FLAT_LEFT: "#56B4E9",
    BookState.LEAN_LEFT: "#E69F00",
    BookState.UPRIGHT: "#009E73",
    BookState.LEAN_RIGHT: "#D55E00",
    BookState.FLAT_RIGHT: "#0072B2",
}
INSERTED = "#4A5A6B"
_INK, _MUTED, _WOOD, _FAILURE = "#1F2933", "#697586", "#B0906A", "#C0392B"

MOVED = 1e-3  # [m] what counts as moved
_UPRIGHT_TILT = 0.05  # [rad] what is drawn as upright or flat before the insertion
_LABEL_ASIDE = 0.3  # of the height
_TALLEST = 200.0  # [in]
_DPI = 150


@dataclass(frozen=True)
class ScenePicture:
    """One scene with its placement and caption."""

    scene: ShelfScene
    placement: Placement | None
    caption: str = ""  # below the picture: cost, bound, or what is missing
    title: str = ""


def build_picture(scene: ShelfScene, answer: SceneAnswer, title: str = "") -> ScenePicture:
    """Build the picture of a scene from the solver's answer, with cost and bound as caption."""
    if answer.placement is None:
        text = str(answer.shortage) if answer.shortage else "no placement found in time"
        return ScenePicture(scene, None, text, title)
    text = f"{answer.objective:.2f} mm²"
    if answer.status != "optimal":
        text += f", at least {answer.bound:.2f}"
    return ScenePicture(scene, answer.placement, text, title)


def infer_states(angle: Array) -> IntArray:
    """Infer the states (...,) of stored books from their angles alone."""
    c, s = np.cos(angle), np.sin(angle)
    state = np.where(s > 0, int(BookState.LEAN_LEFT), int(BookState.LEAN_RIGHT))
    state = np.where(np.abs(s) <= _UPRIGHT_TILT, int(BookState.UPRIGHT), state)
    flat = np.abs(c) <= _UPRIGHT_TILT
    state = np.where(flat & (s > 0), int(BookState.FLAT_LEFT), state)
    return np.where(flat & (s < 0), int(BookState.FLAT_RIGHT), state).astype(np.int64)


def draw_scene(item: ScenePicture, shelf: Shelf) -> Figure:
    """Draw a scene before and after side by side, with arrows and a legend."""
    width, height = 1e3 * shelf.width, 1e3 * shelf.height
    panel = 5.0  # [in]
    figure = _create_figure(2 * panel + 0.6, panel * (height + 18) / (width + 18) + 1.25)
    before, after = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.06})
    draw_before(before, item.scene, shelf)
    before.set_title("before", loc="left", fontsize=10, color=_INK, fontweight="bold")
    tall, thick = 1e3 * item.scene.inserted
    before.set_title(
        f"to insert: {tall:.0f} x {thick:.0f} mm", loc="right", fontsize=9, color=_MUTED
    )
    draw_after(after, item, shelf)
    after.set_title("after", loc="left", fontsize=10, color=_INK, fontweight="bold")
    after.set_title(item.caption, loc="right", fontsize=9, color=_MUTED)
    for ax in (before, after):
        ax.set_xlabel("x [mm]", fontsize=9, color=_INK)
    before.set_ylabel("y [mm]", fontsize=9, color=_INK)
    if item.title:
        figure.suptitle(_escape_text(item.title), fontsize=12, fontweight="bold", color=_INK, x=0.5)
    states = set(infer_states(item.scene.pose[:, 2]).tolist())
    if item.placement is not None:
        states |= set(item.placement.state.tolist())
    _draw_legend(figure, sorted(states))
    return figure


def draw_gallery(
    items: Sequence[ScenePicture], shelf: Shelf, columns: int = 4, title: str = ""
) -> Figure:
    """Draw many scenes, before above after in each cell."""
    columns = max(1, min(columns, len(items)))
    rows = math.ceil(len(items) / columns)
    width, height = 1e3 * shelf.width, 1e3 * shelf.height
    cell = 11.0 / columns  # [in]
    tall = 2 * cell * (height + 18) / (width + 18) + 0.3
    head = 0.4 if title else 0.05
    figure = _create_figure(11.0, rows * tall + 0.5 + head)
    axes = figure.subplots(2 * rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.set_visible(False)
    states: set[int] = set()
    for k, item in enumerate(items):
        row, column = divmod(k, columns)
        upper, lower = axes[2 * row, column], axes[2 * row + 1, column]
        for ax in (upper, lower):
            ax.set_visible(True)
        draw_before(upper, item.scene, shelf)
        draw_after(lower, item, shelf)
        for ax in (upper, lower):
            ax.set_xticks([])
            ax.set_yticks([])
        upper.set_title(_escape_text(item.title), loc="left", fontsize=8, color=_INK)
        color = _MUTED if item.placement is not None else _FAILURE
        upper.set_title(_escape_text(item.caption), loc="right", fontsize=7.5, color=color)
        states |= set(infer_states(item.scene.pose[:, 2]).tolist())
        if item.placement is not None:
            states |= set(item.placement.state.tolist())
    if title:
        figure.suptitle(_escape_text(title), fontsize=12, fontweight="bold", color=_INK)
    _draw_legend(figure, sorted(states))
    return figure


def draw_before(ax: Axes, scene: ShelfScene, shelf: Shelf) -> None:
    """Draw the shelf with the stored books, without the book to insert."""
    _draw_shelf(ax, shelf)
    states = infer_states(scene.pose[:, 2])
    outline = 1e3 * compute_corners(scene.pose, scene.size)
    for k in range(scene.count):
        _draw_book(ax, outline[k], _select_color(states[k]), str(k))
    _set_view(ax, shelf, float(outline[..., 1].max(initial=0.0)))


def draw_after(ax: Axes, item: ScenePicture, shelf: Shelf) -> None:
    """Draw the shelf after the insertion, moved books with their previous outlines and arrows."""
    _draw_shelf(ax, shelf)
    scene, placement = item.scene, item.placement
    before = 1e3 * compute_corners(scene.pose, scene.size)
    if placement is None:
        for outline in before:
            ax.add_patch(_build_outline(outline))
        x, y = 1e3 * (shelf.left + shelf.right) / 2, 0.85e3 * shelf.height
        ax.text(x, y, "no placement", ha="center", va="center", fontsize=10, color=_FAILURE)
        _set_view(ax, shelf, float(before[..., 1].max(initial=0.0)))
        return
    after = 1e3 * compute_corners(placement.pose, scene.sizes)
    for k in range(scene.count):
        if is_moved(scene, placement, k):
            ax.add_patch(_build_outline(before[k]))
    for k in range(scene.count):
        # The arrow covers the centre.
        label_offset = _LABEL_ASIDE if is_moved(scene, placement, k) else 0.0
        _draw_book(ax, after[k], _select_color(placement.state[k]), str(k), label_offset)
    _draw_book(ax, after[-1], INSERTED, hatch="////")
    for k in range(scene.count):
        if is_moved(scene, placement, k):
            _draw_arrow(ax, 1e3 * scene.pose[k, :2], 1e3 * placement.pose[k, :2])
    _set_view(ax, shelf, float(max(before[..., 1].max(), after[..., 1].max())))


def is_moved(scene: ShelfScene, placement: Placement, k: int) -> bool:
    """Return whether a stored book's centre moves by more than 1 mm."""
    step = placement.pose[k, :2] - scene.pose[k, :2]
    return bool(np.hypot(*step) > MOVED)


def encode_png(figure: Figure) -> bytes:
    """Encode a figure as a PNG file."""
    with io.BytesIO() as stream:
        figure.savefig(stream, format="png", dpi=_DPI)
        return stream.getvalue()


def _create_figure(width: float, height: float) -> Figure:
    # The figure of a very narrow shelf would not fit into memory without a limit
    figure = Figure(
        figsize=(width, min(height, _TALLEST)), dpi=_DPI, facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    return figure


def _escape_text(text: str) -> str:
    """Escape text that matplotlib must draw literally."""
    return " ".join(text.split()).replace("$", r"\$")


def _draw_shelf(ax: Axes, shelf: Shelf) -> None:
    left, right, top = 1e3 * shelf.left, 1e3 * shelf.right, 1e3 * shelf.height
    board = 5.0
    for x, y, w, h in (
        (left - board, -board, right - left + 2 * board, board),
        (left - board, 0.0, board, top + board),
        (right, 0.0, board, top + board),
    ):
        ax.add_patch(Rectangle((x, y), w, h, facecolor=_WOOD, edgecolor="none", zorder=1))
    ax.plot([left, right], [top, top], color=_WOOD, lw=0.8, ls=(0, (4, 3)), zorder=1)


def _draw_book(
    ax: Axes,
    outline: Array,
    color: str,
    label: str = "",
    label_offset: float = 0.0,
    hatch: str = "",
) -> None:
    """Draw a book; its label is `label_offset` times the height above the centre."""
    book = Polygon(list(map(tuple, outline)), closed=True, facecolor=color, edgecolor="white")
    book.set(hatch=hatch or None, linewidth=0.8, alpha=0.92, zorder=4)
    ax.add_patch(book)
    if label:
        x, y = outline.mean(axis=0) + label_offset * (outline[0] - outline[1])
        ax.text(x, y, label, ha="center", va="center", fontsize=8, color="white", zorder=7)


def _draw_arrow(ax: Axes, start: Array, end: Array) -> None:
    head = min(11.0, 5.0 + 0.6 * float(np.hypot(*(end - start))))  # [pt]
    arrow = FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-|>", mutation_scale=head)
    arrow.set(linewidth=1.4, color=_INK, zorder=6)
    # A light rim makes it visible on the book below.
    arrow.set_path_effects([Stroke(linewidth=3.0, foreground="white", alpha=0.85), Normal()])
    arrow.shrinkA = arrow.shrinkB = 0.0
    ax.add_patch(arrow)


def _build_outline(outline: Array) -> Polygon:
    """Build the dashed outline of a book's previous pose."""
    ghost = Polygon(list(map(tuple, outline)), closed=True, facecolor="none", edgecolor=_MUTED)
    ghost.set(linewidth=0.9, linestyle=(0, (3, 2)), zorder=5)
    return ghost


def _set_view(ax: Axes, shelf: Shelf, highest: float) -> None:
    left, right, top = 1e3 * shelf.left, 1e3 * shelf.right, 1e3 * shelf.height
    ax.set_xlim(left - 9, right + 9)
    # Books that float far above the shelf are cut off rather than shrinking the picture.
    ax.set_ylim(-8, min(max(top + 10, highest + 4), 2 * top))
    ax.set_aspect("equal")
    ax.spines[:].set_visible(False)
    ax.tick_params(colors=_MUTED, labelsize=8, length=2)


def _select_color(state: int) -> str:
    """Select the color of a state number from a file: red for a number that is no state."""
    return {int(color_by_state): color for color_by_state, color in COLORS.items()}.get(
        int(state), _FAILURE
    )


def _draw_legend(figure: Figure, states: Sequence[int]) -> None:
    handles: list[Patch | Line2D] = [
        Patch(facecolor=_select_color(state), label=state_label(state)) for state in states
    ]
    handles.append(Patch(facecolor=INSERTED, edgecolor="white", hatch="////", label="inserted"))
    handles.append(Line2D([], [], color=_MUTED, lw=0.9, ls=(0, (3, 2)), label="before"))
    handles.append(Line2D([], [], color=_INK, lw=1.6, marker=">", ms=5, label="moved > 1 mm"))
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8.5
    )
