"""Books before and after the insertion, one scene after the other."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.plan.file import read_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan
from climbplan.reports import palette
from climbplan.reports.viewer.scene import Boxes, StaticMesh, ViewerScene, build_block

_DEPTH = 0.08  # [m] of books and shelf as they are drawn: the model is flat
_PULLED = 0.14  # [m] before the shelf where the inserted book waits
_WALL = 0.004  # [m] thickness as drawn
_STEPS = np.array([0.0, 0.5, 1.3, 2.0, 2.6])  # [s] books rest, make room, the book goes in, rest


def read_scene(path: FilePath) -> ViewerScene:
    """Read the scenes of a bookshelf plan file; the model has no time, so the view sets the pace.

    Raises:
        PlanFileError: a damaged file.
    """
    plan = read_shelf_plan(path)
    before = np.full_like(plan.solutions.pose, np.nan)  # (S, n + 1, 3)
    before[:, :-1] = plan.scenes.pose
    placed = plan.solutions.placed
    after = np.where(placed[:, None, None], plan.solutions.pose, before)
    before[:, -1] = after[:, -1]  # the inserted book comes from before its place
    scenes, books = before.shape[:2]
    poses = np.stack([before, before, after, after, after], axis=1)  # (S, 5, n + 1, 3)
    depth = np.zeros((scenes, len(_STEPS), books))
    depth[:, :3, -1] = -_PULLED
    size = plan.scenes.sizes  # (S, n + 1, 2) height, width
    is_visible = np.isfinite(poses).all(axis=-1)
    edges = np.zeros((*poses.shape[:3], 3))
    edges[..., 0], edges[..., 2] = size[:, None, :, 1], size[:, None, :, 0]
    edges[..., 1] = _DEPTH
    poses = np.nan_to_num(poses)
    x, y, angle = np.moveaxis(poses, -1, 0)
    count = scenes * len(_STEPS)
    shelf = plan.shelf
    reach = np.array([shelf.right, _DEPTH / 2, shelf.height])
    return ViewerScene(
        title=plan.name,
        facts=(f"{scenes} scene{'s' if scenes > 1 else ''}, {plan.method}", plan.totals.status),
        time=(np.arange(scenes)[:, None] * _STEPS[-1] + _STEPS).ravel(),
        caption=tuple(text for text in _list_captions(plan) for _ in _STEPS),
        marks=np.arange(0, count, len(_STEPS)),
        shapes=_build_shelf_shapes(plan),
        boxes=Boxes(
            np.stack([x, depth, y], axis=-1).reshape(count, books, 3),
            _build_tilt_rotations(angle).reshape(count, books, 3, 3),
            (edges * is_visible[..., None]).reshape(count, books, 3),
            (*(palette.choose_limb_color(n) for n in range(books - 1)), palette.FAILURE),
        ),
        lower=np.array([shelf.left, -_PULLED, 0.0]),
        upper=reach,
        azimuth_deg=-72.0,
    )


def _build_tilt_rotations(angle: Array) -> Array:
    """Build rotations (..., 3, 3) that tilt books to the left by angles (...)."""
    c, s, zeros, ones = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [[c, zeros, -s], [zeros, ones, zeros], [s, zeros, c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _list_captions(plan: ShelfPlan) -> list[str]:
    solutions = plan.solutions
    texts = []
    for scene, status in enumerate(solutions.status):
        text = f"scene {scene}: {status}"
        if solutions.placed[scene]:
            text += f", {solutions.objective[scene]:.4g} mm²"
        elif solutions.message[scene]:
            text += f", {solutions.message[scene]}"
        texts.append(text)
    return texts


def _build_shelf_shapes(plan: ShelfPlan) -> tuple[StaticMesh, ...]:
    shelf, half = plan.shelf, _DEPTH / 2
    left, right, top = shelf.left, shelf.right, shelf.height
    walls = {
        "ground": ([left - _WALL, -half, -_WALL], [right + _WALL, half, 0.0]),
        "left wall": ([left - _WALL, -half, 0.0], [left, half, top]),
        "right wall": ([right, -half, 0.0], [right + _WALL, half, top]),
        "board above": ([left - _WALL, -half, top], [right + _WALL, half, top + _WALL]),
    }
    return tuple(
        build_block(name, np.array(low), np.array(high), palette.OBSTACLE, 0.6)
        for name, (low, high) in walls.items()
    )
