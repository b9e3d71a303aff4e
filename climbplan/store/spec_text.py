"""The text of the spec that a file was made from."""

from __future__ import annotations

from pathlib import Path

from climbplan.store.hdf5_reading import Reader, open_store


def read_spec_text(path: Path) -> str:
    """Return root attribute `spec`; raises PlanFileError where there is none."""
    with open_store(path) as file:
        return Reader(path, file).text("", "spec")
