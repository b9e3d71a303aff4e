"""Training without warnings that tell nothing here."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

# Many strategies for few rows are what integer programs give; epochs are a budget, not a promise.
_EXPECTED = (
    "The number of unique classes is greater than",
    "The least populated class in y has only",
    "Stochastic Optimizer: Maximum iterations",
)


@contextmanager
def quiet_training() -> Iterator[None]:
    """Silence what scikit-learn says of data that is as it has to be."""
    with warnings.catch_warnings():
        for message in _EXPECTED:
            warnings.filterwarnings("ignore", message=message)
        yield
