"""Independent parts of a table by several processes, in their order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

_Item = TypeVar("_Item")
_Found = TypeVar("_Found")


def in_order(
    work: Callable[[_Item], _Found], items: Iterable[_Item], jobs: int
) -> Iterator[_Found]:
    """What a function finds of each item, in their order and as soon as it is there.

    Results are the same whatever the number of processes: parts share nothing.
    """
    if jobs == 1:
        yield from map(work, items)
        return
    from joblib import Parallel, delayed

    # Arrays are passed as they are: mapped ones are read-only, which would be compiled anew.
    parallel = Parallel(n_jobs=jobs, return_as="generator", max_nbytes=None)
    yield from parallel(delayed(work)(item) for item in items)


def end_workers() -> None:
    """End the processes of tables: their processor time counts once they have ended."""
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True)
