"""Datasets put together and taken apart; a problem is never on both sides of a split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import BoolArray
from climbplan.errors import UsageError
from climbplan.store.dataset import Dataset, describe_frame_difference


@dataclass(frozen=True)
class Merged:
    """Datasets as one."""

    data: Dataset
    dropped: int  # rows whose problem an earlier row holds already


def merge(named_datasets: Sequence[tuple[str, Dataset]], drop_duplicates: bool = False) -> Merged:
    """Return all rows of named datasets of one problem, in order.

    The name, spec and seed are those of the first. Raises UsageError if the problems differ, or if
    a problem is there twice and duplicates are not to be dropped.
    """
    name, first = named_datasets[0]
    for dataset_name, data in named_datasets[1:]:
        if difference := describe_frame_difference(first.frame, data.frame):
            raise UsageError(f"{dataset_name} does not go with {name}: {difference}")
    whole = Dataset.join([data for _, data in named_datasets])
    is_repeated = _mark_repeated(whole)
    if is_repeated.any() and not drop_duplicates:
        first_repeated = int(np.argmax(is_repeated))
        owner = np.repeat([n for n, _ in named_datasets], [d.count for _, d in named_datasets])[
            first_repeated
        ]
        raise UsageError(
            f"{int(is_repeated.sum())} rows hold a problem that an earlier row holds, the first in "
            f"{owner} (seed {int(whole.seed[first_repeated])}): merge datasets of different seeds, "
            "or drop these rows with --drop-duplicates"
        )
    if is_repeated.any():
        whole = whole.rows(np.flatnonzero(~is_repeated))
    verified = all(data.verified for _, data in named_datasets)
    seconds = [data.timings.get("rows") for _, data in named_datasets]
    timings = {"rows": sum(s for s in seconds if isinstance(s, int | float))}
    solvers = {**first.solvers, "merged": len(named_datasets)}
    merged = replace(whole, verified=verified, timings=timings, solvers=solvers, created="")
    return Merged(merged, int(is_repeated.sum()))


@dataclass(frozen=True)
class TrainTestSplit:
    """Masks (n,) over the rows; rows that could not be drawn are in neither."""

    train: BoolArray
    test: BoolArray


def split(data: Dataset, test_share: float, seed: int = 0) -> TrainTestSplit:
    """Divide the problems of a dataset by chance; rows of one problem stay together.

    test_share: of the problems. Raises UsageError if one side would be empty.
    """
    if not 0 < test_share < 1:  # NaN as well
        raise UsageError(f"--test {test_share:g}: expected a share of more than 0 and less than 1")
    is_drawn = data.drawn
    hashes = np.array(data.hashes())
    problems = np.unique(hashes[is_drawn])
    number = round(test_share * len(problems))
    if not 0 < number < len(problems):
        raise UsageError(
            f"{len(problems)} different problems cannot be split with a share of {test_share:g} "
            "for the test"
        )
    chosen = np.random.default_rng(seed).permutation(problems)[:number]
    test = is_drawn & np.isin(hashes, chosen)
    return TrainTestSplit(is_drawn & ~test, test)


def _mark_repeated(data: Dataset) -> BoolArray:
    """Return rows (n,) whose problem an earlier row holds; those without a problem are none."""
    is_drawn = data.drawn
    is_repeated = np.zeros(data.count, bool)
    earlier_hashes: set[str] = set()
    for k, text in enumerate(data.hashes()):
        if is_drawn[k]:
            is_repeated[k] = text in earlier_hashes
            earlier_hashes.add(text)
    return is_repeated
