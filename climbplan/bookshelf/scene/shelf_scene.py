"""Shelf, books and the states they may be in (chapter 8.1.1).

Plane of the shelf's front: x to the right, y up from the ground, both from the middle of the
ground. A book is a rectangle given by its centre and the angle of its height from the vertical;
angle > 0 tilts it to the left. Metres and radians, except where a name says `_mm`.

Published methods, and equation and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, Self

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.errors import UsageError

Unit = Literal["m", "mm"]

_SCALE: dict[str, float] = {"m": 1.0, "mm": 1e-3}
_LARGEST = 100.0  # [m] beyond this a number is a slip of units
_SMALLEST = 1e-6  # [m] a thinner book is one as well
_COLUMNS = ("x", "y", "angle", "height", "width")


class BookState(IntEnum):
    """How a book stands or lies, numbered as in plan files."""

    FLAT_LEFT = 0
    LEAN_LEFT = 1
    UPRIGHT = 2
    LEAN_RIGHT = 3
    FLAT_RIGHT = 4

    @property
    def label(self) -> str:
        """Name of the state in reports: `flat left`, `leaning left`, ..."""
        return _LABELS[self]


_LABELS = {
    BookState.FLAT_LEFT: "flat left",
    BookState.LEAN_LEFT: "leaning left",
    BookState.UPRIGHT: "upright",
    BookState.LEAN_RIGHT: "leaning right",
    BookState.FLAT_RIGHT: "flat right",
}


def state_label(number: int) -> str:
    """Label the state with a number from a file, which may be no state."""
    label_by_number = {int(state): label for state, label in _LABELS.items()}
    return label_by_number.get(number, f"no state ({number})")


@dataclass(frozen=True)
class PublishedTolerances:
    """Shelf and tolerances of the published formulation (its generator draws walls 5 mm thick and
    rounds corners by 2 mm, so that books come to rest 7 mm inside its frame)."""

    half_width: float = 0.088  # [m] frame from its middle
    height: float = 0.110  # [m]
    distance: float = 1.5e-3  # [m] on every equation and inequality between points
    sine: float = 0.05  # on the sine of a state's angle
    left_wall: float = 7e-3  # [m] on top of `distance`: what a book leaning on the left wall keeps


@dataclass(frozen=True)
class Shelf:
    """The shelf and the rules of the meaning `contact`."""

    left: float = -0.08111  # [m] left wall
    right: float = 0.08111  # [m] right wall
    height: float = 0.110  # [m] clear height above the ground
    book_gap: float = 4.1e-3  # [m] a book that leans on a book is at most this far from it
    wall_gap: float = 1.5e-3  # [m] a book that leans on a wall is at most this far from it
    lean_margin: float = 0.0  # [rad] a leaning book tilts at least atan(width / height) plus this
    published: PublishedTolerances = field(default_factory=PublishedTolerances)

    def __post_init__(self) -> None:
        numbers = (self.left, self.right, self.height, self.book_gap, self.wall_gap)
        if not all(map(math.isfinite, (*numbers, self.lean_margin))):
            raise UsageError(f"shelf: expected finite numbers, got {self}")
        if max(map(abs, (*numbers, self.lean_margin))) > _LARGEST:
            raise UsageError(f"shelf: expected numbers up to {_LARGEST:g} m, got {self}")
        if self.left >= self.right or self.height <= 0:
            raise UsageError("shelf: expected left < right and height > 0")
        if min(self.book_gap, self.wall_gap, self.lean_margin) < 0:
            raise UsageError("shelf: expected gaps and lean margin >= 0")

    @property
    def width(self) -> float:
        """Distance between the walls [m]."""
        return self.right - self.left

    def min_lean_angle(self, size: Array) -> Array:
        """Return the smallest tilt (...) [rad] at which gravity presses a book on its support.

        The centre of mass is then beyond the foot, eq. (8.9), K2: |a| >= atan(width / height).

        Args:
            size: (..., 2) height, width [m].
        """
        tilt: Array = np.minimum(
            np.arctan2(size[..., 1], size[..., 0]) + self.lean_margin, math.pi / 2
        )
        return tilt


@dataclass(frozen=True)
class ShelfScene:
    """Stored books from left to right, and the book to insert."""

    pose: Array  # (n, 3) x [m], y [m], angle [rad] of the stored books before the insertion
    size: Array  # (n, 2) height, width [m]
    inserted: Array  # (2,) height, width [m]

    @property
    def count(self) -> int:
        """Number of stored books."""
        return len(self.pose)

    @property
    def sizes(self) -> Array:
        """Height and width (n + 1, 2) [m] of all books, the inserted one last."""
        return np.vstack([self.size, self.inserted])


class WrongScenes(UsageError):
    """Numbers that cannot describe books, all of them."""

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        super().__init__("; ".join(faults))


@dataclass(frozen=True)
class Scenes:
    """S scenes with n stored books each."""

    pose: Array  # (S, n, 3)
    size: Array  # (S, n, 2)
    inserted: Array  # (S, 2)

    @classmethod
    def of(cls, scenes: Sequence[ShelfScene]) -> Self:
        """Scenes that all store the same number of books."""
        return cls(
            np.stack([s.pose for s in scenes]),
            np.stack([s.size for s in scenes]),
            np.stack([s.inserted for s in scenes]),
        )

    @classmethod
    def from_theta(cls, theta: Array, unit: Unit = "m") -> Self:
        """Scenes from rows (S, 5 n + 2): n times x, y, angle, height, width, then height, width.

        Raises:
            WrongScenes: naming every row and column that cannot describe books.
        """
        scenes = cls.from_theta_unchecked(theta, unit)
        scenes.require()
        return scenes

    @classmethod
    def from_theta_unchecked(cls, theta: Array, unit: Unit = "m") -> Self:
        """Build scenes from rows as `from_theta` does, but accept all numbers.

        Raises:
            UsageError: no rows of that many columns.
        """
        rows = np.atleast_2d(np.asarray(theta, float))
        columns = rows.shape[1]
        if rows.ndim != 2 or len(rows) == 0 or columns % 5 != 2 or columns < 7:
            raise UsageError(
                f"theta has shape {np.shape(theta)}, expected (scenes, 5 n + 2) for at least one"
                " scene of n >= 1 books"
            )
        scale = _SCALE[unit]
        stored = rows[:, :-2].reshape(len(rows), -1, 5)
        pose = stored[..., :3] * np.array([scale, scale, 1.0])
        return cls(pose, stored[..., 3:] * scale, rows[:, -2:] * scale)

    def require(self) -> None:
        """Refuse sizes and poses that cannot be those of books.

        Raises:
            WrongScenes: naming every wrong number.
        """
        if faults := self.faults():
            raise WrongScenes(faults)

    def theta(self, unit: Unit = "m") -> Array:
        """Rows (S, 5 n + 2) as read by `from_theta`."""
        scale = 1 / _SCALE[unit]
        stored = np.concatenate([self.pose * np.array([scale, scale, 1.0]), self.size * scale], 2)
        return np.concatenate([stored.reshape(len(self), -1), self.inserted * scale], axis=1)

    def faults(self) -> list[str]:
        """Return a message for each number that cannot describe a book."""
        table = np.concatenate([self.pose, self.size], axis=2)
        descriptions = []
        for scene, book, column in zip(*np.nonzero(_find_wrong_entries(table)), strict=True):
            value = table[scene, book, column]
            descriptions.append(
                f"scene {scene}, book {book}: {_COLUMNS[column]} is {_describe_fault(value)}"
            )
        for scene, column in zip(*np.nonzero(_find_wrong_entries(self.inserted, 0)), strict=True):
            value = self.inserted[scene, column]
            descriptions.append(
                f"scene {scene}, inserted: {_COLUMNS[3 + column]} is {_describe_fault(value)}"
            )
        return descriptions

    @property
    def count(self) -> int:
        """Number of stored books."""
        return self.pose.shape[1]

    @property
    def sizes(self) -> Array:
        """Height and width (S, n + 1, 2) [m] of all books, the inserted one last."""
        return np.concatenate([self.size, self.inserted[:, None]], axis=1)

    def __len__(self) -> int:
        return len(self.pose)

    def __getitem__(self, index: int) -> ShelfScene:
        return ShelfScene(self.pose[index], self.size[index], self.inserted[index])

    def __iter__(self) -> Iterator[ShelfScene]:
        return (self[k] for k in range(len(self)))


def _find_wrong_entries(values: Array, first_size: int = 3) -> BoolArray:
    """Find entries that are not finite or too large, or too small from column `first_size` on."""
    wrong = ~(np.abs(values) <= _LARGEST)
    wrong[..., first_size:] |= ~(values[..., first_size:] >= _SMALLEST)
    return wrong


def _describe_fault(value: float) -> str:
    if not math.isfinite(value):
        return f"{value}, expected a finite number"
    if abs(value) > _LARGEST:
        return f"{value:g}, expected at most {_LARGEST:g} in size"
    if value > 0:
        return f"{value:g}, expected at least {_SMALLEST:g}"
    return f"{value:g}, expected more than 0"


def compute_movement_cost(scenes: Scenes, pose: Array) -> Array:
    """Compute the movement cost (S,) [mm^2] of the stored books.

    It is the sum over stored books of (dx^2 + dy^2) / (1 mm)^2 + (cos a - cos a0)^2.

    Args:
        scenes: poses before the insertion.
        pose: (S, n + 1, 3) x [m], y [m], angle [rad] after the insertion. The inserted book is last
            and costs nothing.
    """
    displacement = 1e3 * (pose[:, :-1, :2] - scenes.pose[..., :2])
    cosine_change = np.cos(pose[:, :-1, 2]) - np.cos(scenes.pose[..., 2])
    cost: Array = (displacement**2).sum(axis=(1, 2)) + (cosine_change**2).sum(axis=1)
    return cost
