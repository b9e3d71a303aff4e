"""Physical scenes: books dropped onto a shelf, one taken out again (chapter 8.1, facts of the
published generator: X. Lin et al., arXiv 2110.00666, and its source code).

Books of random size fall side by side in pymunk until everything rests on the ground. The book that
stands most upright is taken out, the rest comes to rest again, and the one taken out is to be
inserted. The shelf grows with the number of books. Simulated lengths are millimetres; books carry a
skin of 2 mm, walls are 5 mm thick to each side, so that centres are shifted by 7 mm.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.bookshelf.scene.rectangles import compute_half_extents
from climbplan.bookshelf.scene.shelf_scene import PublishedTolerances, Scenes, Shelf, ShelfScene
from climbplan.errors import LimitReached, MissingSolver

WALL = 5.0  # [mm] half thickness
SKIN = 2.0  # [mm] radius of a book's corners
_SLOP = 0.11  # [mm] that pymunk lets bodies sink into each other, and a hair


@dataclass(frozen=True)
class DropRules:
    """How books are drawn and dropped; the values of Lin et al."""

    width_mm: tuple[int, int] = (10, 40)  # whole numbers, both ends included
    height_mm: tuple[int, int] = (50, 90)
    gap_mm: tuple[int, int] = (5, 38)  # of four books: see `starts`
    gap_less_mm: float = 1.5  # by which the largest gap shrinks with each book beyond four
    step_mm: int = 20  # largest difference in height between neighbours at the start
    tilt: float = 1.2  # [rad] largest at the start
    most_upright: float = 0.2  # [rad] a book that tilts more is not taken out
    nearly_upright: float = 0.05  # [rad] scenes with less tilt everywhere ...
    # ... are kept with this probability. As published they may be a fifth of all: a third of what
    # comes to rest with four books is like that.
    upright_kept: float = 0.49
    room_mm: float | None = None  # between the frame's sides: 44 (176 in all) a book if left out
    book_friction: float = 0.1
    wall_friction: float = 1.0
    wall_elasticity: float = 0.5
    mass: float = 5.0
    gravity: float = 1000.0  # [mm/s^2]
    step: float = 1 / 60  # [s]
    seconds: float = 5.0  # to come to rest
    energy: float = 5e-25  # kinetic energy of a book at rest
    attempts: int = 2000


def build_drop_shelf(count: int, rules: DropRules | None = None) -> Shelf:
    """Build the shelf onto which `count` + 1 books are dropped; it fits them at their widest."""
    rules = rules or DropRules()
    half = _compute_half_frame(count + 1, rules)
    inner, clear = 1e-3 * (half - WALL - SKIN + _SLOP), 1e-3 * (rules.height_mm[1] + 20)
    published = PublishedTolerances(half_width=1e-3 * half, height=clear)
    return Shelf(left=-inner, right=inner, height=clear, published=published)


def generate_scene(seed: int, index: int, count: int, rules: DropRules | None = None) -> ShelfScene:
    """Generate scene `index` of a seed with `count` stored books, reproducibly.

    Raises:
        MissingSolver: pymunk is not installed.
        LimitReached: no drop came to rest by the rules within the attempts.
    """
    return draw_scene(np.random.default_rng([seed, count, index]), count, rules)


def draw_scene(rng: np.random.Generator, count: int, rules: DropRules | None = None) -> ShelfScene:
    """Draw a scene with `count` stored books: drop books until one scene meets the rules.

    Raises:
        MissingSolver: pymunk is not installed.
        LimitReached: no drop came to rest by the rules within the attempts.
    """
    rules = rules or DropRules()
    pymunk = _import_pymunk()
    for _ in range(rules.attempts):
        scene = _drop_books(pymunk, rng, count, rules)
        if scene is not None:
            return scene
    raise LimitReached(
        f"no scene of {count} books came to rest in {rules.attempts} drops; larger shelves or "
        "fewer books come to rest more often"
    )


def generate_scenes(
    seed: int,
    scenes: int,
    count: int,
    rules: DropRules | None = None,
    progress: Callable[[int], None] | None = None,
) -> Scenes:
    """Generate `scenes` scenes with `count` stored books; raises as `generate_scene`."""
    generated = []
    for index in range(scenes):
        generated.append(generate_scene(seed, index, count, rules))
        if progress is not None:
            progress(len(generated))
    return Scenes.of(generated)


def _compute_half_frame(books: int, rules: DropRules) -> float:
    """Compute the distance from the middle of the frame to its sides [mm]."""
    frame_width = (rules.width_mm[1] + 4) * books if rules.room_mm is None else rules.room_mm
    return frame_width / 2


def _import_pymunk() -> ModuleType:
    try:
        import pymunk
    except ImportError as error:
        raise MissingSolver(
            "scenes are simulated with pymunk, which is not installed: "
            "pip install 'climbplan[data]'"
        ) from error
    return pymunk


def _drop_books(
    pymunk: ModuleType, rng: np.random.Generator, count: int, rules: DropRules
) -> ShelfScene | None:
    """One drop; None if it does not come to rest as wanted."""
    books = count + 1
    half = _compute_half_frame(books, rules)
    width = rng.integers(rules.width_mm[0], rules.width_mm[1], books, endpoint=True).astype(float)
    height = rng.integers(rules.height_mm[0], rules.height_mm[1], books, endpoint=True).astype(
        float
    )
    min_gap, max_gap = rules.gap_mm
    max_gap = max(min_gap, math.floor(max_gap - rules.gap_less_mm * (books - 4)))
    gap = rng.integers(min_gap, max_gap, books, endpoint=True)
    tilt = rng.uniform(-rules.tilt, rules.tilt, books)
    walk = np.cumsum(rng.integers(-rules.step_mm, rules.step_mm, books, endpoint=True))
    upright_wanted = rng.random() < rules.upright_kept
    # As published, half of each book's width counts: wide neighbours start at different heights or
    # overlap, and push each other apart.
    x = -half + np.cumsum(gap + width / 2) - width / 4
    clear = rules.height_mm[1] + 20
    y = 2 * clear / 3 + walk

    space, bodies = _create_space(pymunk, rules, half, np.stack([x, y, tilt], 1), (width, height))
    if not _simulate_until_rest(space, bodies, rules):
        return None
    pose = _read_poses(bodies)
    if not _is_standing(pose, height, width):
        return None
    removed = int(np.argmin(np.abs(pose[:, 2])))
    if abs(pose[removed, 2]) > rules.most_upright:
        return None
    space.remove(bodies[removed], *bodies[removed].shapes)
    remaining = [k for k in range(books) if k != removed]
    if not _simulate_until_rest(space, [bodies[k] for k in remaining], rules):
        return None
    pose = _read_poses([bodies[k] for k in remaining])
    if not _is_standing(pose, height[remaining], width[remaining]):
        return None
    if np.abs(pose[:, 2]).max() <= rules.nearly_upright and not upright_wanted:
        return None
    pose[:, :2] *= 1e-3
    size = 1e-3 * np.stack([height, width], axis=1)
    return ShelfScene(pose, size[remaining], size[removed])


def _create_space(
    pymunk: ModuleType, rules: DropRules, half: float, pose: Array, size: tuple[Array, Array]
) -> tuple[Any, list[Any]]:
    """Create the simulated frame and the books in it.

    Args:
        pymunk: the module.
        rules: frictions, masses and gravity.
        half: distance from the middle of the frame to its sides [mm].
        pose: (n, 3) x, y [mm] and angle [rad] of the books at the start.
        size: widths (n,) and heights (n,) [mm].
    """
    (x, y, tilt), (width, height) = pose.T, size
    clear = rules.height_mm[1] + 20
    space = pymunk.Space()
    space.gravity = (0.0, -rules.gravity)
    wall_top = 20.0 * clear
    for a, b in (
        ((-half, 0.0), (half, 0.0)),
        ((-half, 0.0), (-half, wall_top)),
        ((half, 0.0), (half, wall_top)),
    ):
        wall = pymunk.Segment(space.static_body, a, b, WALL)
        wall.friction, wall.elasticity = rules.wall_friction, rules.wall_elasticity
        space.add(wall)
    bodies = []
    for k in range(len(pose)):
        body = pymunk.Body(rules.mass, pymunk.moment_for_box(rules.mass, (width[k], height[k])))
        body.position, body.angle = (float(x[k]), float(y[k])), float(tilt[k])
        shape = pymunk.Poly.create_box(body, (width[k], height[k]), SKIN)
        shape.friction = rules.book_friction
        space.add(body, shape)
        bodies.append(body)
    return space, bodies


def _simulate_until_rest(space: Any, bodies: list[Any], rules: DropRules) -> bool:
    """Simulate until all books rest; False if the time ends before."""
    quiet = 0
    for _ in range(round(rules.seconds / rules.step)):
        space.step(rules.step)
        still = all(body.kinetic_energy < rules.energy for body in bodies)
        quiet = quiet + 1 if still else 0
        if quiet == 3:
            return True
    return False


def _read_poses(bodies: list[Any]) -> Array:
    """Read x, y, angle (n, 3) [mm, rad] with the ground at y = 0 and angles modulo pi."""
    pose = np.array([(*body.position, body.angle) for body in bodies], float)
    pose[:, 1] -= WALL + SKIN
    pose[:, 2] = pose[:, 2] - math.pi * np.round(pose[:, 2] / math.pi)
    return pose


def _is_standing(pose: Array, height: Array, width: Array) -> bool:
    """Return whether every book is on the ground and all are in order from left to right."""
    reach = compute_half_extents(pose[:, 2], np.stack([height, width], axis=1))
    on_ground = np.abs(pose[:, 1] - reach[:, 1]) < 0.5
    return bool(on_ground.all() and (np.diff(pose[:, 0]) > 0).all())
