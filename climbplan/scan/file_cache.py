"""Scans of specs, read and repaired once as long as their files do not change."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from climbplan.scan.raw import RawScan
from climbplan.scan.reading import read_scan
from climbplan.schema.terrain.scan import ScanSpec


def load_scan(scan: ScanSpec, directory: Path) -> RawScan:
    """Return a whole scan, repaired; it is read once.

    Raises:
        ScanError: the file is no scan.
    """
    text = scan.model_dump_json(
        exclude={"fit", "flatness", "min_size", "toe_radius", "guide", "steepest_deg", "holds"}
    )
    return _read_cached_scan(text, directory, _compute_file_stamp(directory / scan.file))


@lru_cache(maxsize=4)
def _read_cached_scan(scan: str, directory: Path, stamp: tuple[int, ...]) -> RawScan:
    """Read a scan; the stamp of its file is part of the cache's key."""
    return read_scan(ScanSpec.model_validate_json(scan), directory)


def _compute_file_stamp(path: Path) -> tuple[int, ...]:
    """Return modification time and size of a file; () if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return (status.st_mtime_ns, status.st_size)
