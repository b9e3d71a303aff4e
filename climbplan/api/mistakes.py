"""Mistakes that only planning finds, shown at the lines of the spec."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from climbplan.errors import SpecError

if TYPE_CHECKING:
    from climbplan.schema.loaded import LoadedSpec


@contextmanager
def placed_mistakes(loaded: LoadedSpec) -> Iterator[None]:
    """Give every spec mistake raised inside its line in `loaded`."""
    try:
        yield
    except SpecError as error:
        raise loaded.locate(error) from error
