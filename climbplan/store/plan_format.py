"""Which kind of plan a file holds."""

from __future__ import annotations

from pathlib import Path

from climbplan.store.hdf5_reading import Reader, open_store


def read_plan_format(path: Path) -> str:
    """Return the file's attribute `format`, such as `climbplan/climb`.

    Raises PlanFileError for a file that is missing, damaged or not one of climbplan's.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        if not reader.has_attribute("", "format"):
            raise reader.refuse("HDF5, but not a climbplan file (no attribute `format`)")
        return reader.text("", "format")
