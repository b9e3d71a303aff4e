"""The sheet that figures are drawn on: the picture that `savefig` writes, for half its work."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from climbplan.reports.sheet import (
    TALLEST,
    build_panel_grid,
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    new_figure,
    render_figures,
    render_png,
    style_axes,
)


def drawn(figure: Figure) -> Figure:
    """Something on every panel."""
    for ax in figure.axes:
        (line,) = ax.plot([0.0, 1.0, 2.0], [0.0, 2000.0, 1.0], label="load")
        style_axes(ax)
        draw_panel_title(ax, "panel", "note")
        ax.set_ylabel("load [N]")
        ax.set_xlabel("time [s]")
    draw_foot_legend(figure, [line], ["load"])
    draw_heading(figure, "Loads", "on the right")
    return figure


def two_panels() -> Figure:
    figure = new_figure(4.0, entries=1)
    figure.subplots(1, 2)
    return drawn(figure)


def test_the_picture_is_the_one_that_savefig_writes() -> None:
    saved = io.BytesIO()
    two_panels().savefig(saved, format="png")
    written = Image.open(io.BytesIO(render_png(two_panels())))
    expected = np.asarray(Image.open(saved).convert("RGB"))
    np.testing.assert_array_equal(np.asarray(written), expected)
    assert written.info["dpi"] == pytest.approx((150, 150), abs=0.1)


def test_a_figure_is_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 0
    draw = Figure.draw

    def counted(figure: Figure, *given: object) -> None:
        nonlocal count
        count += 1
        draw(figure, *given)

    monkeypatch.setattr(Figure, "draw", counted)
    images = render_figures("plan", {"one": lambda plan: two_panels()})
    assert images["one"].startswith(b"\x89PNG")
    assert count == 1


@pytest.mark.parametrize("own_heights", [False, True])
def test_equal_panels_leave_room_for_what_stands_round_them(own_heights: bool) -> None:
    figure, axes = build_panel_grid(6.0, entries=1, rows=2, columns=2, own_heights=own_heights)
    assert axes.shape == (2, 2)
    drawn(figure)
    if own_heights:
        for ax in axes[:, 1]:
            ax.set_ylabel("")
    render_png(figure)
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    boxes = [ax.get_tightbbox(renderer) for ax in axes.ravel()]
    assert min(box.x0 for box in boxes) > 0
    assert max(box.x1 for box in boxes) < figure.bbox.x1
    head = min(text.get_window_extent(renderer).y0 for text in figure.texts)
    assert max(box.y1 for box in boxes) < head
    foot = figure.legends[0].get_window_extent(renderer).y1
    assert min(box.y0 for box in boxes) > foot - 8  # the legend's frame is not drawn
    sizes = {(round(ax.bbox.width), round(ax.bbox.height)) for ax in axes.ravel()}
    assert len(sizes) == 1


def test_figures_end_somewhere() -> None:
    """A plan file may claim postures a thousand kilometres high."""
    for figure in (new_figure(1e9, entries=3), build_panel_grid(1e9, entries=3, rows=2).figure):
        assert figure.get_size_inches()[1] == TALLEST
