"""Figures of a trained strategy: clusters in two spaces, ranks, calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array, IntArray
from climbplan.learning.clusters import build_solution_vectors
from climbplan.learning.model import StrategyModel
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    new_figure,
    style_axes,
)

_MOST_POINTS = 1200  # of a picture: t-SNE takes seconds for so many
_NAMED = 8  # largest groups with a colour of their own
_REST = "#C9D1DA"


def draw_spaces(model: StrategyModel, columns: IntArray, seed: int) -> Figure:
    """Return groups in the space of solutions (left) and of features (right), as Figure 8.3."""
    library = model.library
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(library.size)[:_MOST_POINTS])
    clusters = model.cluster is not None
    group = library.strategy if model.cluster is None else model.cluster
    inside = group[group >= 0]
    largest = np.argsort(-np.bincount(inside), kind="stable")[:_NAMED]
    figure = new_figure(5.2, entries=len(largest) + 1)
    left, right = figure.subplots(1, 2)
    vectors = build_solution_vectors(library, columns)[rows]
    for ax, points, title in (
        (left, vectors, "Solutions"),
        (right, library.features[rows] / model.scale, "Features of the problems"),
    ):
        _draw_scatter(ax, _project_to_plane(points, seed), group[rows], largest)
        draw_panel_title(ax, title, f"{points.shape[1]} dimensions")
    handles = [
        Line2D([], [], ls="", marker="o", ms=6, color=_choose_color(k)) for k in range(_NAMED)
    ]
    handles = [*handles[: len(largest)], Line2D([], [], ls="", marker="o", ms=6, color=_REST)]
    group_label = "cluster" if clusters else "strategy"
    # Nine names have to fit into one row.
    names = [f"{int(k)} ({int((inside == k).sum())})" for k in largest]
    draw_foot_legend(figure, handles, [*names, "others"])
    draw_heading(
        figure,
        f"{group_label.capitalize()} of each solved problem",
        f"{len(rows)} of {library.size} drawn; in colour: {group_label} (problems)",
    )
    return figure


def draw_ranks(evaluation: Mapping[str, Any]) -> Figure:
    """Return how often the right integers are among the first candidates, and calibration."""
    figure = new_figure(3.8, entries=2)
    left, right = figure.subplots(1, 2)
    handles, labels = [], []
    for key, label, color in (
        ("within_first", "all problems held out", palette.LIMBS[0]),
        ("within_first_hard", "non-trivial ones", palette.LIMBS[1]),
    ):
        shares = {int(k): v for k, v in evaluation[key].items() if v is not None}
        if shares:
            (line,) = left.plot(
                list(shares), [100 * v for v in shares.values()], "o-", color=color, lw=1.6, ms=4
            )
            handles.append(line)
            labels.append(label)
    left.set_xscale("log")
    left.set_xticks([1, 3, 5, 10, 20, 50], ["1", "3", "5", "10", "20", "50"])
    left.minorticks_off()
    left.set_ylim(0, 102)
    left.set_xlabel("first candidates")
    left.set_ylabel("right one among them [%]")
    style_axes(left)
    draw_panel_title(left, "Ranking", f"{evaluation['problems']} problems")
    _draw_calibration(right, evaluation["calibration"])
    if handles:
        draw_foot_legend(figure, handles, labels)
    draw_heading(figure, "Problems that were held out", "")
    return figure


def _draw_calibration(ax: Axes, bins: list[dict[str, float]]) -> None:
    style_axes(ax)
    ax.plot([0, 1], [0, 1], color=palette.MUTED, lw=1, ls="--")
    predicted = [entry["predicted"] for entry in bins]
    observed = [entry["observed"] for entry in bins]
    ax.plot(predicted, observed, "o-", color=palette.LIMBS[2], lw=1.6, ms=5)
    for entry in bins:
        ax.annotate(
            f"{entry['problems']:.0f}",
            (entry["predicted"], entry["observed"]),
            textcoords="offset points",
            xytext=(6, -10),
            fontsize=8,
            color=palette.MUTED,
        )
    ax.set_xlim(0, 1.02)
    ax.set_ylim(0, 1.02)
    ax.set_xlabel("probability of the first candidate")
    ax.set_ylabel("share in which it is right")
    draw_panel_title(ax, "Calibration", "numbers: problems" if bins else "no probabilities")


def _project_to_plane(points: Array, seed: int) -> Array:
    """Return points (S, d) in the plane (S, 2)."""
    from sklearn.manifold import TSNE

    spread = points.std(axis=0)
    if len(points) < 5 or not (spread > 0).any():
        return np.asarray(np.hstack([points, np.zeros((len(points), 2))])[:, :2])
    method = TSNE(
        2,
        perplexity=min(30.0, (len(points) - 1) / 3),
        init="pca" if points.shape[1] > 1 else "random",
        random_state=seed,
        n_jobs=1,
    )
    return np.asarray(method.fit_transform(points))


def _draw_scatter(ax: Axes, plane: Array, group: IntArray, largest: IntArray) -> None:
    is_other = ~np.isin(group, largest)
    ax.scatter(plane[is_other, 0], plane[is_other, 1], s=7, color=_REST, linewidths=0)
    for k, number in enumerate(largest):
        is_member = group == number
        ax.scatter(
            plane[is_member, 0], plane[is_member, 1], s=9, color=_choose_color(k), linewidths=0
        )
    style_axes(ax)
    # Places in a map of neighbours have no unit.
    ax.set_xticks([])
    ax.set_yticks([])
    for side in ("left", "bottom"):
        ax.spines[side].set_visible(False)


def _choose_color(k: int) -> str:
    return palette.choose_limb_color(k)
