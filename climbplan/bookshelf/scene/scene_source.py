"""From a bookshelf spec to its shelf and scenes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from climbplan.bookshelf.scene.rectangles import half_extents
from climbplan.bookshelf.scene.scene_file import NoSuchGroup, read_scenes
from climbplan.bookshelf.scene.shelf_scene import (
    PublishedTolerances,
    Scene,
    Scenes,
    Shelf,
    WrongScenes,
)
from climbplan.bookshelf.schema.loading import LoadedShelf
from climbplan.bookshelf.schema.model import BookshelfSpec, ShelfSceneSpec, ShelfSpec
from climbplan.errors import SpecError, SpecMistake, UsageError

_MOST_ROWS = 20  # wrong numbers of a file that are listed


def shelf_of(spec: ShelfSpec) -> Shelf:
    """The shelf as written in a spec."""
    published = spec.published
    return Shelf(
        left=spec.left_mm / 1000,
        right=spec.right_mm / 1000,
        height=spec.height_mm / 1000,
        book_gap=spec.book_gap_mm / 1000,
        wall_gap=spec.wall_gap_mm / 1000,
        lean_margin=math.radians(spec.lean_margin_deg),
        published=PublishedTolerances(
            half_width=published.half_width_mm / 1000,
            height=published.height_mm / 1000,
            distance=published.distance_mm / 1000,
            sine=published.sine,
            left_wall=published.left_wall_mm / 1000,
        ),
    )


def scene_of(spec: ShelfSceneSpec) -> Scene:
    """The scene as written in a spec; books without a height stand on the ground."""
    size = np.array([(b.height_mm, b.width_mm) for b in spec.books], float)
    angle = np.radians([b.tilt_deg for b in spec.books])
    ground = half_extents(angle, size)[:, 1]
    y = [g if b.y_mm is None else b.y_mm for b, g in zip(spec.books, ground, strict=True)]
    pose = np.stack([1e-3 * np.array([b.x_mm for b in spec.books]), 1e-3 * np.array(y), angle], 1)
    inserted = np.array([spec.insert.height_mm, spec.insert.width_mm])
    return Scene(pose, 1e-3 * size, 1e-3 * inserted)


def scenes_of_inline(spec: ShelfSceneSpec) -> Scenes:
    """The one scene as written in a spec."""
    return Scenes.of([scene_of(spec)])


def scenes_of(spec: BookshelfSpec, directory: Path) -> Scenes:
    """All scenes of a spec; files are looked up from `directory`.

    Raises:
        UsageError: numbers in a file that cannot be books.
        PlanFileError: a file that is missing, damaged or of another kind.
    """
    if spec.scene is not None:
        scenes = scenes_of_inline(spec.scene)
        scenes.require()
        return scenes
    if spec.scenes is None:
        raise ValueError("a bookshelf spec has a scene or scenes")
    return read_scenes(directory / spec.scenes.file, spec.scenes.group)


def loaded_scenes(loaded: LoadedShelf) -> Scenes:
    """All scenes of a loaded spec.

    Raises:
        SpecError: with the key of the spec that is to blame, and every wrong row of a file.
    """
    try:
        return scenes_of(loaded.spec, loaded.directory)
    except WrongScenes as error:
        key = "scene" if loaded.spec.scenes is None else "scenes.file"
        messages = list(error.faults[:_MOST_ROWS])
        if len(error.faults) > _MOST_ROWS:
            messages.append(f"and {len(error.faults) - _MOST_ROWS} more wrong numbers")
    except NoSuchGroup as error:
        key, messages = "scenes.group", [str(error)]
    except UsageError as error:
        key, messages = "scenes.file", [str(error)]
    raise loaded.placed(SpecError(loaded.source, [SpecMistake(key, text) for text in messages]))
