"""Datasets put together and taken apart; a problem is never on both sides of a split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.errors import UsageError
from climbplan.store.dataset import Dataset, differing_frame


@dataclass(frozen=True)
class Merged:
    """Datasets as one."""

    data: Dataset
    dropped: int  # rows whose problem an earlier row holds already


def merge(parts: Sequence[tuple[str, Dataset]], drop_duplicates: bool = False) -> Merged:
    """All rows of named datasets of one problem, in order.

    The name, spec and seed are those of the first. Raises UsageError if the problems differ, or if
    a problem is there twice and duplicates are not to be dropped.
    """
    name, first = parts[0]
    for other, data in parts[1:]:
        if difference := differing_frame(first.frame, data.frame):
            raise UsageError(f"{other} does not go with {name}: {difference}")
    whole = Dataset.joined([data for _, data in parts])
    again = _again(whole)
    if again.any() and not drop_duplicates:
        at = int(np.argmax(again))
        owner = np.repeat([n for n, _ in parts], [d.count for _, d in parts])[at]
        raise UsageError(
            f"{int(again.sum())} rows hold a problem that an earlier row holds, the first in "
            f"{owner} (seed {int(whole.seed[at])}): merge datasets of different seeds, or drop "
            "these rows with --drop-duplicates"
        )
    if again.any():
        whole = whole.rows(np.flatnonzero(~again))
    verified = all(data.verified for _, data in parts)
    seconds = [data.timings.get("rows") for _, data in parts]
    timings = {"rows": sum(s for s in seconds if isinstance(s, int | float))}
    solvers = {**first.solvers, "merged": len(parts)}
    merged = replace(whole, verified=verified, timings=timings, solvers=solvers, created="")
    return Merged(merged, int(again.sum()))


@dataclass(frozen=True)
class Split:
    """Masks (n,) over the rows; rows that could not be drawn are in neither."""

    train: BoolArray
    test: BoolArray


def split(data: Dataset, test_share: float, seed: int = 0) -> Split:
    """Divide the problems of a dataset by chance; rows of one problem stay together.

    test_share: of the problems. Raises UsageError if one side would be empty.
    """
    if not 0 < test_share < 1:  # NaN as well
        raise UsageError(f"--test {test_share:g}: expected a share of more than 0 and less than 1")
    drawn = data.drawn
    hashes = np.array(data.hashes())
    problems = np.unique(hashes[drawn])
    number = round(test_share * len(problems))
    if not 0 < number < len(problems):
        raise UsageError(
            f"{len(problems)} different problems cannot be split with a share of {test_share:g} "
            "for the test"
        )
    chosen = np.random.default_rng(seed).permutation(problems)[:number]
    test = drawn & np.isin(hashes, chosen)
    return Split(drawn & ~test, test)


def _again(data: Dataset) -> BoolArray:
    """Rows (n,) whose problem an earlier row holds; those without a problem are none."""
    drawn = data.drawn
    again = np.zeros(data.count, bool)
    seen: set[str] = set()
    for k, text in enumerate(data.hashes()):
        if drawn[k]:
            again[k] = text in seen
            seen.add(text)
    return again
