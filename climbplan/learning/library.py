"""Solved problems of one program, from which every learned strategy is made.

Rows are problems: features, the solution's point, its cost. A strategy is a row of integers, chosen
alternatives and labels; equal ones are stored once. Labels are discrete properties that a statement
leaves to the continuous variables (the slot of an inserted book): points that differ in them are
different starts of a local method.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import PlanFileError, UsageError
from climbplan.program import Program
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_text

FORMAT = "climbplan/library"
FORMAT_VERSION = 1
_FEATURES = DatasetLayout(("S", "p"))
_POINTS = DatasetLayout(("S", "N"))
_OBJECTIVE = DatasetLayout(("S",))
_ALTERNATIVES = DatasetLayout(("S", "C"), kind="int")
_LABELS = DatasetLayout(("S", "L"), kind="int")
_INTEGER = DatasetLayout(("N",), kind="bool")
_OPTIONS = DatasetLayout(("C",), kind="int")


@dataclass(frozen=True)
class ProgramSignature:
    """Properties in which a library and a program must agree."""

    name: str  # name of the program
    integer: BoolArray  # (N,) mask of binaries
    options: IntArray  # (C,) number of alternatives of each choice

    @classmethod
    def of(cls, program: Program) -> ProgramSignature:
        """Return the frame of a program."""
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
    """S solved problems of one program, with U different strategies."""

    frame: ProgramSignature
    features: Array  # (S, p)
    points: Array  # (S, N) integers rounded
    objective: Array  # (S,)
    alternatives: IntArray  # (S, C)
    labels: IntArray  # (S, L)
    strategies: BoolArray  # (U, B) values of the binaries
    strategy_alternatives: IntArray  # (U, C)
    strategy_labels: IntArray  # (U, L)
    strategy: IntArray  # (S,) strategy of each problem

    @classmethod
    def of(
        cls,
        frame: ProgramSignature,
        features: Array,
        points: Array,
        objective: Array,
        alternatives: IntArray | None = None,
        labels: IntArray | None = None,
    ) -> Library:
        """Build a library; strategies are numbered in order of appearance.

        Args:
            frame: Frame of the program.
            features: (S, p).
            points: (S, N) solutions.
            objective: (S,) costs.
            alternatives: (S, C), may be missing without choices.
            labels: (S, L), none by default.

        Raises:
            UsageError: Shapes do not fit, numbers are not finite, binaries differ from 0 and 1 by
                more than 1e-3, or an alternative does not exist.
        """
        X = np.array(points, float)
        F, f = np.asarray(features, float), np.asarray(objective, float)
        C = len(frame.options)
        chosen = np.zeros((len(X), 0), np.int64) if alternatives is None else alternatives
        chosen = np.asarray(chosen, np.int64)
        tags = np.zeros((len(X), 0), np.int64) if labels is None else np.asarray(labels, np.int64)
        is_consistent = X.ndim == F.ndim == tags.ndim == 2 and f.shape == (len(X),)
        is_consistent = is_consistent and len(F) == len(tags) == len(X)
        if not is_consistent or X.shape[1] != len(frame.integer) or chosen.shape != (len(X), C):
            raise UsageError(
                f"library of {frame.name!r}: features {F.shape}, points {X.shape}, objective "
                f"{f.shape}, alternatives {chosen.shape} and labels {tags.shape} do not fit "
                f"{len(frame.integer)} variables and {C} choices"
            )
        if not all(np.isfinite(array).all() for array in (X, F, f)):
            raise UsageError(f"library of {frame.name!r}: a number is not finite")
        bits = X[:, frame.integer]
        if (np.abs(bits - np.round(bits)) > 1e-3).any() or ((bits < -0.5) | (bits > 1.5)).any():
            raise UsageError(f"library of {frame.name!r}: a binary is neither 0 nor 1")
        if ((chosen < 0) | (chosen >= frame.options)).any():
            raise UsageError(f"library of {frame.name!r}: an alternative that there is not")
        X[:, frame.integer] = np.round(bits)
        key = np.hstack([np.round(bits).astype(np.int64), chosen, tags])
        unique, strategy = _number_strategies(key)
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
            strategy=strategy,
        )

    @property
    def size(self) -> int:
        """Number of problems S."""
        return len(self.features)

    def subset(self, rows: IntArray) -> Library:
        """Return the library of some of the problems."""
        return Library.of(
            self.frame,
            self.features[rows],
            self.points[rows],
            self.objective[rows],
            self.alternatives[rows],
            self.labels[rows],
        )

    def require(self, program: Program, feature_count: int | None = None) -> None:
        """Check that this is a library of a program and of some number of features.

        Raises:
            UsageError: It is not.
        """
        expected = ProgramSignature.of(program)
        is_same = np.array_equal(expected.integer, self.frame.integer)
        is_same = is_same and np.array_equal(expected.options, self.frame.options)
        if not is_same or expected.name != self.frame.name:
            raise UsageError(
                f"a library of {self.frame.name!r} ({len(self.frame.integer)} variables) does not "
                f"serve {expected.name!r} ({len(expected.integer)} variables)"
            )
        if feature_count is not None and self.features.shape[1] != feature_count:
            raise UsageError(
                f"a library with {self.features.shape[1]} features, expected {feature_count}"
            )


def _number_strategies(key: IntArray) -> tuple[IntArray, IntArray]:
    """Number the different rows of keys (S, k) in order of appearance.

    Returns:
        The rows (U, k) in that order, and the number of each problem's row (S,).
    """
    unique, first_row, strategy = np.unique(key, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first_row, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return unique[order], rank[np.ravel(strategy)]


def write_library(library: Library, path: Path) -> None:
    """Write a library.

    Raises:
        UsageError: The file cannot be written.
    """
    with create_store(path) as file:
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

    Raises:
        PlanFileError: The file is missing, damaged, of another kind, or its numbers cannot be those
            of solved problems.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        kind = reader.text("", "format")
        if kind != FORMAT:
            raise reader.refuse(f"format {kind!r}, expected {FORMAT!r}")
        version = reader.integer("", "format_version")
        if version != FORMAT_VERSION:
            raise reader.refuse(f"format version {version}, expected {FORMAT_VERSION}")
        frame = ProgramSignature(
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
