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
from climbplan.bookshelf.scene.rectangles import corners
from climbplan.bookshelf.scene.shelf_scene import Scene, Shelf, State, state_label

# Told apart with any common colour blindness (after Okabe and Ito): both leans, both flats.
COLORS = {
    State.FLAT_LEFT: "#56B4E9",
    State.LEAN_LEFT: "#E69F00",
    State.UPRIGHT: "#009E73",
    State.LEAN_RIGHT: "#D55E00",
    State.FLAT_RIGHT: "#0072B2",
}
INSERTED = "#4A5A6B"
_INK, _MUTED, _WOOD, _FAILURE = "#1F2933", "#697586", "#B0906A", "#C0392B"

MOVED = 1e-3  # [m] what counts as moved
_UPRIGHT_TILT = 0.05  # [rad] what is drawn as upright or flat before the insertion
_LABEL_ASIDE = 0.3  # of the height
_TALLEST = 200.0  # [in]
_DPI = 150


@dataclass(frozen=True)
class Pictured:
    """One scene and what became of it."""

    scene: Scene
    placement: Placement | None
    caption: str = ""  # below the picture: cost, bound, or what is missing
    title: str = ""


def pictured(scene: Scene, answer: SceneAnswer, title: str = "") -> Pictured:
    """A scene with the solver's answer, its figures as the caption."""
    if answer.placement is None:
        text = str(answer.shortage) if answer.shortage else "no placement found in time"
        return Pictured(scene, None, text, title)
    text = f"{answer.objective:.2f} mm²"
    if answer.status != "optimal":
        text += f", at least {answer.bound:.2f}"
    return Pictured(scene, answer.placement, text, title)


def states_before(angle: Array) -> IntArray:
    """What stored books look like by their angles alone (...,)."""
    c, s = np.cos(angle), np.sin(angle)
    state = np.where(s > 0, int(State.LEAN_LEFT), int(State.LEAN_RIGHT))
    state = np.where(np.abs(s) <= _UPRIGHT_TILT, int(State.UPRIGHT), state)
    flat = np.abs(c) <= _UPRIGHT_TILT
    state = np.where(flat & (s > 0), int(State.FLAT_LEFT), state)
    return np.where(flat & (s < 0), int(State.FLAT_RIGHT), state).astype(np.int64)


def scene_figure(item: Pictured, shelf: Shelf) -> Figure:
    """Before and after side by side, with arrows and a legend."""
    width, height = 1e3 * shelf.width, 1e3 * shelf.height
    panel = 5.0  # [in]
    figure = _figure(2 * panel + 0.6, panel * (height + 18) / (width + 18) + 1.25)
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
        figure.suptitle(_plain(item.title), fontsize=12, fontweight="bold", color=_INK, x=0.5)
    states = set(states_before(item.scene.pose[:, 2]).tolist())
    if item.placement is not None:
        states |= set(item.placement.state.tolist())
    _legend(figure, sorted(states))
    return figure


def gallery(items: Sequence[Pictured], shelf: Shelf, columns: int = 4, title: str = "") -> Figure:
    """Many scenes, before above after in each cell."""
    columns = max(1, min(columns, len(items)))
    rows = math.ceil(len(items) / columns)
    width, height = 1e3 * shelf.width, 1e3 * shelf.height
    cell = 11.0 / columns  # [in]
    tall = 2 * cell * (height + 18) / (width + 18) + 0.3
    head = 0.4 if title else 0.05
    figure = _figure(11.0, rows * tall + 0.5 + head)
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
        upper.set_title(_plain(item.title), loc="left", fontsize=8, color=_INK)
        color = _MUTED if item.placement is not None else _FAILURE
        upper.set_title(_plain(item.caption), loc="right", fontsize=7.5, color=color)
        states |= set(states_before(item.scene.pose[:, 2]).tolist())
        if item.placement is not None:
            states |= set(item.placement.state.tolist())
    if title:
        figure.suptitle(_plain(title), fontsize=12, fontweight="bold", color=_INK)
    _legend(figure, sorted(states))
    return figure


def draw_before(ax: Axes, scene: Scene, shelf: Shelf) -> None:
    """The shelf with the stored books; the book to insert is not on it yet."""
    _draw_shelf(ax, shelf)
    states = states_before(scene.pose[:, 2])
    outline = 1e3 * corners(scene.pose, scene.size)
    for k in range(scene.count):
        _draw_book(ax, outline[k], _color(states[k]), str(k))
    _set_view(ax, shelf, float(outline[..., 1].max(initial=0.0)))


def draw_after(ax: Axes, item: Pictured, shelf: Shelf) -> None:
    """The shelf after the insertion; moved books with their old outlines and arrows."""
    _draw_shelf(ax, shelf)
    scene, placement = item.scene, item.placement
    before = 1e3 * corners(scene.pose, scene.size)
    if placement is None:
        for outline in before:
            ax.add_patch(_outline(outline))
        x, y = 1e3 * (shelf.left + shelf.right) / 2, 0.85e3 * shelf.height
        ax.text(x, y, "no placement", ha="center", va="center", fontsize=10, color=_FAILURE)
        _set_view(ax, shelf, float(before[..., 1].max(initial=0.0)))
        return
    after = 1e3 * corners(placement.pose, scene.sizes)
    for k in range(scene.count):
        if moved(scene, placement, k):
            ax.add_patch(_outline(before[k]))
    for k in range(scene.count):
        # The label makes way for the arrow.
        aside = _LABEL_ASIDE if moved(scene, placement, k) else 0.0
        _draw_book(ax, after[k], _color(placement.state[k]), str(k), aside)
    _draw_book(ax, after[-1], INSERTED, hatch="////")
    for k in range(scene.count):
        if moved(scene, placement, k):
            _draw_arrow(ax, 1e3 * scene.pose[k, :2], 1e3 * placement.pose[k, :2])
    _set_view(ax, shelf, float(max(before[..., 1].max(), after[..., 1].max())))


def moved(scene: Scene, placement: Placement, k: int) -> bool:
    """Whether a stored book's centre was moved by more than 1 mm."""
    step = placement.pose[k, :2] - scene.pose[k, :2]
    return bool(np.hypot(*step) > MOVED)


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    with io.BytesIO() as stream:
        figure.savefig(stream, format="png", dpi=_DPI)
        return stream.getvalue()


def _figure(width: float, height: float) -> Figure:
    # A shelf may be as narrow as anything: pixels of more would not go into memory
    figure = Figure(
        figsize=(width, min(height, _TALLEST)), dpi=_DPI, facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    return figure


def _plain(text: str) -> str:
    """Text that matplotlib draws as it is written."""
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
    ax: Axes, outline: Array, color: str, label: str = "", aside: float = 0.0, hatch: str = ""
) -> None:
    """A book; its label `aside` times the height above the centre, along the book."""
    book = Polygon(list(map(tuple, outline)), closed=True, facecolor=color, edgecolor="white")
    book.set(hatch=hatch or None, linewidth=0.8, alpha=0.92, zorder=4)
    ax.add_patch(book)
    if label:
        x, y = outline.mean(axis=0) + aside * (outline[0] - outline[1])
        ax.text(x, y, label, ha="center", va="center", fontsize=8, color="white", zorder=7)


def _draw_arrow(ax: Axes, start: Array, end: Array) -> None:
    head = min(11.0, 5.0 + 0.6 * float(np.hypot(*(end - start))))  # [pt]
    arrow = FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-|>", mutation_scale=head)
    arrow.set(linewidth=1.4, color=_INK, zorder=6)
    # A light rim keeps it apart from the book below.
    arrow.set_path_effects([Stroke(linewidth=3.0, foreground="white", alpha=0.85), Normal()])
    arrow.shrinkA = arrow.shrinkB = 0.0
    ax.add_patch(arrow)


def _outline(outline: Array) -> Polygon:
    """Where a book was."""
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


def _color(state: int) -> str:
    """Of a state as a file has it: red for one that there is not."""
    return {int(known): color for known, color in COLORS.items()}.get(int(state), _FAILURE)


def _legend(figure: Figure, states: Sequence[int]) -> None:
    handles: list[Patch | Line2D] = [
        Patch(facecolor=_color(state), label=state_label(state)) for state in states
    ]
    handles.append(Patch(facecolor=INSERTED, edgecolor="white", hatch="////", label="inserted"))
    handles.append(Line2D([], [], color=_MUTED, lw=0.9, ls=(0, (3, 2)), label="before"))
    handles.append(Line2D([], [], color=_INK, lw=1.6, marker=">", ms=5, label="moved > 1 mm"))
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8.5
    )
