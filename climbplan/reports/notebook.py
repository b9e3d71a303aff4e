"""Plans and datasets in notebooks: badge, key figures and a replay that needs no network.

The replay is a page of its own in an `iframe`, so that neither its styles nor its scripts touch the
notebook.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from markupsafe import Markup

from climbplan.reports.page_parts import build_policy, build_style, read_part
from climbplan.reports.page_template import build_data_element, fill
from climbplan.reports.scene_replay import build_scene_replay
from climbplan.reports.viewer.scene import ViewerScene
from climbplan.store.dataset import Dataset
from climbplan.store.dataset_statistics import compute_statistics
from climbplan.verification.level import Level

MAX_FRAMES = 150  # of a replay in a notebook, whose file keeps them
_MAX_ROWS = 5  # of a dataset in a notebook
_CONTROLS_HEIGHT = 110  # [pixels] below the picture
COLOURS = {Level.FINE: "#1a7f37", Level.LOOK: "#9a6700", Level.DO_NOT_USE: "#cf222e"}


def build_replay_page(scene: ViewerScene, height: int) -> str:
    """Return a self-contained page that replays a scene.

    Args:
        scene: Scene of a plan.
        height: Height of the picture [pixels].
    """
    script = read_part("replay.js")
    return fill(
        "inline.html",
        policy=Markup(build_policy((script,))),
        style=Markup(build_style()),
        title=scene.title,
        height=height,
        replay_values=build_data_element("replay-data", build_scene_replay(scene))["replay-data"],
        script=Markup(script),
    )


def build_replay_frame(scene: ViewerScene, height: int) -> str:
    """Return the replay as an element of a notebook; height: of the picture [pixels]."""
    page = html.escape(build_replay_page(thin_scene(scene), height), quote=True)
    return (
        f'<iframe title="{html.escape(scene.title, quote=True)}" srcdoc="{page}" '
        f'sandbox="allow-scripts" style="width:100%;height:{height + _CONTROLS_HEIGHT}px;border:0">'
        "</iframe>"
    )


def thin_scene(scene: ViewerScene) -> ViewerScene:
    """Return the scene with at most `MAX_FRAMES` of its samples, evenly spaced, ends included."""
    count = len(scene.time)
    if count <= MAX_FRAMES:
        return scene
    rows = np.linspace(0, count - 1, MAX_FRAMES).round().astype(int)
    boxes, rods, forces = scene.boxes, scene.rods, scene.forces
    return replace(
        scene,
        time=scene.time[rows],
        caption=tuple(scene.caption[row] for row in rows),
        marks=np.zeros(0, dtype=np.int64),
        solids=None,  # which the replay does not draw
        boxes=boxes
        and replace(
            boxes,
            center=boxes.center[rows],
            rotation=boxes.rotation[rows],
            size=boxes.size[rows],
        ),
        rods=rods and replace(rods, ends=rods.ends[rows], load=None),
        forces=forces
        and replace(
            forces,
            point=forces.point[rows],
            force=forces.force[rows],
            normal=forces.normal[rows],
            mu=forces.mu[rows],
        ),
    )


def build_badge(level: Level, badge: str, advice: str) -> str:
    """Return the level of a plan, its badge and what to do, as HTML."""
    return (
        f'<p><b style="background:{COLOURS[level]};color:#fff;padding:0 .4em;border-radius:.25em">'
        f"{html.escape(level.label)}</b> · "
        f"{html.escape(badge)}: {html.escape(advice)}</p>"
    )


def build_dataset_tables(data: Dataset) -> str:
    """Return how the rows of a dataset ended, what they cost and took, and the first ones, as HTML.

    Args:
        data: The dataset.
    """
    statistics = compute_statistics(data)
    unit = f" [{data.frame.objective_unit}]" if data.frame.objective_unit else ""
    rows = statistics["rows"]
    counts = ", ".join(f"{count} {status}" for status, count in data.statuses.items() if count)
    summary = (
        f"{data.frame.problem}: {rows['count']} rows, {rows['answered']} answered ({counts}); "
        f"{len(data.frame.parameter_names)} parameters, {len(data.frame.integer_names)} integers, "
        f"{statistics['strategies']['distinct']} different sets of integers"
    )
    names = ("mean", "median", "most99", "largest")
    amounts = [
        ["", "mean", "median", "99 %", "largest"],
        *(
            [title, *(_format_amount(statistics[key][name]) for name in names)]
            for title, key in ((f"cost{unit}", "cost"), ("time [s]", "time"))
        ),
    ]
    first_rows = slice(0, _MAX_ROWS)
    columns = (data.row, data.seed, data.status, data.objective, data.time)
    listed = [("row", "seed", "status", f"cost{unit}", "time [s]")]
    listed += [
        (str(row), str(seed), str(status), _format_amount(cost), _format_amount(seconds))
        for row, seed, status, cost, seconds in zip(*(c[first_rows] for c in columns), strict=True)
    ]
    return f"<p>{html.escape(summary)}</p>{_build_table(amounts)}{_build_table(listed)}"


def _format_amount(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""


def _build_table(rows: Sequence[Sequence[str]]) -> str:
    """Return a table as HTML; the first row is its head."""
    lines = [
        "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
        for tag, row in zip(["th", *["td"] * (len(rows) - 1)], rows, strict=True)
    ]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def build_figures(lines: Sequence[str]) -> str:
    """Return lines about a plan as HTML."""
    text = html.escape("\n".join(lines))
    return f'<pre style="white-space:pre-wrap;margin:0">{text}</pre>' if lines else ""
