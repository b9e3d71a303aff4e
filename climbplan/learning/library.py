"""Solved problems of one program: what every learned strategy is made from.

Rows are problems: features, the solution's point, its objective. A strategy is a row of integers,
chosen alternatives and labels; equal ones are stored once. Labels are what a problem's statement
leaves to the continuous variables although it is a choice (the slot of an inserted book): points
that differ in them are different starts for a local method.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import PlanFileError, UsageError
from climbplan.program import Program
from climbplan.store.hdf5_layout import Layout
from climbplan.store.hdf5_reading import Reader, opened_store
from climbplan.store.hdf5_writing import new_store, write_dataset, write_text

FORMAT = "climbplan/library"
FORMAT_VERSION = 1
_FEATURES = Layout(("S", "p"))
_POINTS = Layout(("S", "N"))
_OBJECTIVE = Layout(("S",))
_ALTERNATIVES = Layout(("S", "C"), kind="int")
_LABELS = Layout(("S", "L"), kind="int")
_INTEGER = Layout(("N",), kind="bool")
_OPTIONS = Layout(("C",), kind="int")


@dataclass(frozen=True)
class Frame:
    """What a library and a program must agree on."""

    name: str  # of the program
    integer: BoolArray  # (N,) which variables are binaries
    options: IntArray  # (C,) alternatives of each choice

    @classmethod
    def of(cls, program: Program) -> Frame:
        """The frame of a program."""
        blocks = program.blocks
        integer = [np.full(v.lower.size, v.integer) for v in blocks.variables]
        options = [len(a) for c in blocks.choices for a in c.alternatives]
        return cls(
            program.name,
            np.concatenate([np.zeros(0, bool), *integer]),
            np.array(options, np.int64),
        )


@dataclass(frozen=True)
class Library:
    """S solved problems of one program, U different strategies among them."""

    frame: Frame
    features: Array  # (S, p)
    points: Array  # (S, N) integers rounded
    objective: Array  # (S,)
    alternatives: IntArray  # (S, C)
    labels: IntArray  # (S, L)
    strategies: BoolArray  # (U, B) values of the binaries
    strategy_alternatives: IntArray  # (U, C)
    strategy_labels: IntArray  # (U, L)
    strategy: IntArray  # (S,) which one each problem has

    @classmethod
    def of(
        cls,
        frame: Frame,
        features: Array,
        points: Array,
        objective: Array,
        alternatives: IntArray | None = None,
        labels: IntArray | None = None,
    ) -> Library:
        """Put solved problems together; strategies are numbered in order of appearance.

        features: (S, p). points: (S, N). objective: (S,). alternatives: (S, C), may be left out
        without choices. labels: (S, L), none if left out. Raises UsageError for shapes that do not
        fit, numbers that are not finite, binaries off 0 and 1 by more than 1e-3 and alternatives
        that there are not.
        """
        X = np.array(points, float)
        F, f = np.asarray(features, float), np.asarray(objective, float)
        C = len(frame.options)
        chosen = np.zeros((len(X), 0), np.int64) if alternatives is None else alternatives
        chosen = np.asarray(chosen, np.int64)
        tags = np.zeros((len(X), 0), np.int64) if labels is None else np.asarray(labels, np.int64)
        fits = X.ndim == F.ndim == tags.ndim == 2 and f.shape == (len(X),)
        fits = fits and len(F) == len(tags) == len(X)
        if not fits or X.shape[1] != len(frame.integer) or chosen.shape != (len(X), C):
            raise UsageError(
                f"library of {frame.name!r}: features {F.shape}, points {X.shape}, objective "
                f"{f.shape}, alternatives {chosen.shape} and labels {tags.shape} do not fit "
                f"{len(frame.integer)} variables and {C} choices"
            )
        if not all(np.isfinite(part).all() for part in (X, F, f)):
            raise UsageError(f"library of {frame.name!r}: a number is not finite")
        bits = X[:, frame.integer]
        if (np.abs(bits - np.round(bits)) > 1e-3).any() or ((bits < -0.5) | (bits > 1.5)).any():
            raise UsageError(f"library of {frame.name!r}: a binary is neither 0 nor 1")
        if ((chosen < 0) | (chosen >= frame.options)).any():
            raise UsageError(f"library of {frame.name!r}: an alternative that there is not")
        X[:, frame.integer] = np.round(bits)
        key = np.hstack([np.round(bits).astype(np.int64), chosen, tags])
        unique, where, strategy = np.unique(key, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(where, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        unique = unique[order]
        B = int(frame.integer.sum())
        return cls(
            frame=frame,
            features=F,
            points=X,
            objective=f,
            alternatives=chosen,
            labels=tags,
            strategies=unique[:, :B].astype(bool),
            strategy_alternatives=unique[:, B : B + C],
            strategy_labels=unique[:, B + C :],
            strategy=rank[np.ravel(strategy)],
        )

    @property
    def size(self) -> int:
        """S."""
        return len(self.features)

    def subset(self, rows: IntArray) -> Library:
        """The library of some of the problems."""
        return Library.of(
            self.frame,
            self.features[rows],
            self.points[rows],
            self.objective[rows],
            self.alternatives[rows],
            self.labels[rows],
        )

    def require(self, program: Program, feature_count: int | None = None) -> None:
        """Raises UsageError if this is a library of another program or of other features."""
        wanted = Frame.of(program)
        same = np.array_equal(wanted.integer, self.frame.integer)
        same = same and np.array_equal(wanted.options, self.frame.options)
        if not same or wanted.name != self.frame.name:
            raise UsageError(
                f"a library of {self.frame.name!r} ({len(self.frame.integer)} variables) does not "
                f"serve {wanted.name!r} ({len(wanted.integer)} variables)"
            )
        if feature_count is not None and self.features.shape[1] != feature_count:
            raise UsageError(
                f"a library with {self.features.shape[1]} features, expected {feature_count}"
            )


def write_library(library: Library, path: Path) -> None:
    """Write a library; raises UsageError if the file cannot be written."""
    with new_store(path) as file:
        write_text(file, "format", FORMAT)
        file.attrs["format_version"] = FORMAT_VERSION
        write_text(file, "program", library.frame.name)
        write_dataset(file, "integer", library.frame.integer, _INTEGER)
        write_dataset(file, "options", library.frame.options, _OPTIONS)
        write_dataset(file, "features", library.features, _FEATURES)
        write_dataset(file, "points", library.points, _POINTS)
        write_dataset(file, "objective", library.objective, _OBJECTIVE)
        write_dataset(file, "alternatives", library.alternatives, _ALTERNATIVES)
        write_dataset(file, "labels", library.labels, _LABELS)


def read_library(path: Path) -> Library:
    """Read a library; nothing in it is executed.

    Raises PlanFileError for a file that is missing, damaged, of another kind, or whose numbers
    cannot be those of solved problems.
    """
    with opened_store(path) as file:
        reader = Reader(path, file)
        kind = reader.text("", "format")
        if kind != FORMAT:
            raise reader.refuse(f"format {kind!r}, expected {FORMAT!r}")
        version = reader.integer("", "format_version")
        if version != FORMAT_VERSION:
            raise reader.refuse(f"format version {version}, expected {FORMAT_VERSION}")
        frame = Frame(
            reader.text("", "program"),
            reader.array("integer", _INTEGER),
            reader.array("options", _OPTIONS),
        )
        features = reader.array("features", _FEATURES)
        points = reader.array("points", _POINTS)
        objective = reader.array("objective", _OBJECTIVE)
        alternatives = reader.array("alternatives", _ALTERNATIVES)
        labels = reader.array("labels", _LABELS)
        if reader.not_finite:
            raise reader.refuse(f"{', '.join(reader.not_finite)} holds numbers that are not finite")
        if (frame.options < 1).any():
            raise reader.refuse("options holds a choice without alternatives")
    try:
        return Library.of(frame, features, points, objective, alternatives, labels)
    except PlanFileError:
        raise
    except UsageError as error:
        raise PlanFileError(f"{path}: {error}") from error
