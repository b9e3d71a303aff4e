"""Root attributes of all stored results: what a file is, and where it comes from.

format, format_version, climbplan_version, created, name, spec, spec_sha256, seed, status, verified,
and what each kind adds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Protocol

import h5py
import numpy as np

import climbplan
from climbplan.plans.hdf5_reading import Reader
from climbplan.plans.hdf5_writing import write_json, write_text


class Made(Protocol):
    """Something that was made from a spec."""

    @property
    def name(self) -> str: ...
    @property
    def spec_text(self) -> str: ...
    @property
    def spec_sha256(self) -> str: ...
    @property
    def seed(self) -> int: ...
    @property
    def verified(self) -> bool: ...
    @property
    def created(self) -> str: ...
    @property
    def climbplan_version(self) -> str: ...


@dataclass(frozen=True)
class Origin:
    """`Made` for what does not have these names itself."""

    name: str
    spec_text: str
    spec_sha256: str
    seed: int
    verified: bool
    created: str = ""
    climbplan_version: str = ""


def write_root(
    file: h5py.File,
    made: Made,
    form: str,
    version: int,
    *,
    texts: Mapping[str, str],
    numbers: Mapping[str, float | None],
    objects: Mapping[str, Any],
) -> None:
    """Write them; an empty `created` or `climbplan_version` becomes now and this version.

    texts, numbers, objects (JSON): what the kind adds, `status` among them. Numbers that are None
    are left out.
    """
    shared = {
        "format": form,
        "climbplan_version": made.climbplan_version or climbplan.__version__,
        "created": made.created or datetime.now(UTC).isoformat(timespec="seconds"),
        "name": made.name,
        "spec": made.spec_text,
        "spec_sha256": made.spec_sha256,
    }
    for name, text in {**shared, **texts}.items():
        write_text(file, name, text)
    file.attrs["format_version"] = version
    file.attrs["seed"] = made.seed
    file.attrs["verified"] = np.bool_(made.verified)
    for name, number in numbers.items():
        if number is not None:
            file.attrs[name] = float(number)
    for name, value in objects.items():
        write_json(file, name, value)


def read_root(reader: Reader) -> dict[str, Any]:
    """What `Made` has, by name."""
    return {
        "name": reader.text("", "name"),
        "spec_text": reader.text("", "spec"),
        "spec_sha256": reader.text("", "spec_sha256"),
        "seed": reader.integer("", "seed"),
        "verified": reader.flag("", "verified"),
        "created": reader.text("", "created"),
        "climbplan_version": reader.text("", "climbplan_version"),
    }


def require_plan(reader: Reader, version: int, *formats: str) -> None:
    """Raise PlanFileError unless the file is a plan of one of these formats and this version."""
    if not reader.has_attribute("", "format"):
        raise reader.refuse("HDF5, but not a climbplan file (no attribute `format`)")
    found = reader.text("", "format")
    if found not in formats:
        expected = " or ".join(repr(form) for form in formats)
        raise reader.refuse(f"holds {found!r}, expected {expected}")
    _require_version(reader, version)


def require_other(reader: Reader, version: int, form: str, what: str) -> None:
    """Raise PlanFileError unless the file is `what`, of this format and version."""
    if not reader.has_attribute("", "format") or reader.text("", "format") != form:
        raise reader.refuse(f"not {what} ({form})")
    _require_version(reader, version)


def _require_version(reader: Reader, version: int) -> None:
    found = reader.integer("", "format_version")
    if found != version:
        newer = "; a newer climbplan reads it" if found > version else ""
        raise reader.refuse(f"format version {found}, expected {version}{newer}")
