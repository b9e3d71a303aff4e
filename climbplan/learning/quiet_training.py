"""Train without warnings that are expected here."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

# Integer programs give many strategies for few rows, and the number of epochs is a budget.
_EXPECTED = (
    "The number of unique classes is greater than",
    "The least populated class in y has only",
    "Stochastic Optimizer: Maximum iterations",
)


@contextmanager
def suppress_expected_warnings() -> Iterator[None]:
    """Suppress scikit-learn's warnings about data and budgets that are intended."""
    with warnings.catch_warnings():
        for message in _EXPECTED:
            warnings.filterwarnings("ignore", message=message)
        yield
