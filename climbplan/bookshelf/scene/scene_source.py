"""Shelf and scenes of a bookshelf spec."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climbplan.bookshelf.scene.rectangles import compute_half_extents
from climbplan.bookshelf.scene.scene_file import NoSuchGroup, read_scenes
from climbplan.bookshelf.scene.shelf_scene import (
    PublishedTolerances,
    Scenes,
    Shelf,
    ShelfScene,
    WrongScenes,
)
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.bookshelf.schema.model import BookshelfSpec, ShelfSceneSpec, ShelfSpec
from climbplan.errors import SpecError, SpecMistake, UsageError

_MOST_ROWS = 20  # wrong numbers of a file that are listed


def build_shelf(spec: ShelfSpec) -> Shelf:
    """Build the shelf of a spec."""
    published = spec.published
    return Shelf(
        left=spec.left_mm / 1000,
        right=spec.right_mm / 1000,
        height=spec.height_mm / 1000,
        book_gap=spec.max_book_gap_mm / 1000,
        wall_gap=spec.max_wall_gap_mm / 1000,
        lean_margin=math.radians(spec.lean_margin_deg),
        published=PublishedTolerances(
            half_width=published.half_width_mm / 1000,
            height=published.height_mm / 1000,
            distance=published.distance_tolerance_mm / 1000,
            sine=published.sine_tolerance,
            left_wall=published.left_wall_tolerance_mm / 1000,
        ),
    )


def build_scene(spec: ShelfSceneSpec) -> ShelfScene:
    """Build the scene of a spec; books without `y_mm` stand on the ground."""
    size = np.array([(b.height_mm, b.width_mm) for b in spec.books], float)
    angle = np.radians([b.tilt_deg for b in spec.books])
    ground = compute_half_extents(angle, size)[:, 1]
    y = [g if b.y_mm is None else b.y_mm for b, g in zip(spec.books, ground, strict=True)]
    pose = np.stack([1e-3 * np.array([b.x_mm for b in spec.books]), 1e-3 * np.array(y), angle], 1)
    inserted = np.array([spec.insert.height_mm, spec.insert.width_mm])
    return ShelfScene(pose, 1e-3 * size, 1e-3 * inserted)


def build_inline_scenes(spec: ShelfSceneSpec) -> Scenes:
    """Build the only scene of a spec."""
    return Scenes.of([build_scene(spec)])


def read_spec_scenes(spec: BookshelfSpec, directory: Path) -> Scenes:
    """Read all scenes of a spec; paths are relative to `directory`.

    Raises:
        UsageError: numbers in a file that cannot be books.
        PlanFileError: a file that is missing, damaged or of another kind.
    """
    if spec.scene is not None:
        scenes = build_inline_scenes(spec.scene)
        scenes.require()
        return scenes
    if spec.scenes is None:
        raise ValueError("a bookshelf spec has a scene or scenes")
    return read_scenes(directory / spec.scenes.file, spec.scenes.group)


def load_scenes(loaded: LoadedShelf) -> Scenes:
    """Load all scenes of a spec.

    Raises:
        SpecError: with the key of the spec that is to blame, and every wrong row of a file.
    """
    try:
        return read_spec_scenes(loaded.spec, loaded.directory)
    except WrongScenes as error:
        key = "scene" if loaded.spec.scenes is None else "scenes.file"
        messages = list(error.faults[:_MOST_ROWS])
        if len(error.faults) > _MOST_ROWS:
            messages.append(f"and {len(error.faults) - _MOST_ROWS} more wrong numbers")
    except NoSuchGroup as error:
        key, messages = "scenes.group", [str(error)]
    except UsageError as error:
        key, messages = "scenes.file", [str(error)]
    raise loaded.locate(SpecError(loaded.source, [SpecMistake(key, text) for text in messages]))
