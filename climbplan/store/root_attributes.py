"""What all stored results say of themselves: what a file is, where it comes from, how it was made.

Root attributes format, format_version, climbplan_version, created, name, spec, spec_sha256, seed,
status, verified, and what each kind adds; of plans timings, solvers and sizes, too, and the
datasets `warnings`, `notes` and `summary`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import climbplan
from climbplan.errors import PlanFileError
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader
from climbplan.store.hdf5_writing import write_dataset, write_json, write_text

_WORDS = DatasetLayout(("*",), kind="text")
_LISTED = 3  # names in a message


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Where a stored result comes from."""

    name: str
    spec_text: str
    spec_sha256: str
    seed: int
    verified: bool = False
    created: str = ""  # when it is written, if empty
    climbplan_version: str = ""  # this one, if empty


@dataclass(frozen=True, kw_only=True)
class PlanHeader(Origin):
    """What plans of all kinds say of themselves."""

    timings: Mapping[str, Any] = field(default_factory=dict)  # [s] by stage
    solvers: Mapping[str, Any] = field(default_factory=dict)  # stage -> solver and version
    sizes: Mapping[str, Any] = field(default_factory=dict)  # of problems, by stage
    warnings: tuple[str, ...] = ()  # what to look at before the plan is used
    notes: tuple[str, ...] = ()  # what the planner changed on its way; nothing is to be done
    summary: tuple[str, ...] = ()  # lines for the terminal
    # Found when reading: datasets and attributes
    not_finite: tuple[str, ...] = field(default=(), compare=False)
    at_odds: tuple[str, ...] = field(default=(), compare=False)  # what a file says twice, otherwise


def write_root(
    file: h5py.File,
    origin: Origin,
    form: str,
    version: int,
    *,
    texts: Mapping[str, str],
    numbers: Mapping[str, float | None],
    objects: Mapping[str, Any],
) -> None:
    """Write the root attributes of any stored result.

    texts, numbers, objects (JSON): what the kind adds, `status` among them. Numbers that are None
    are left out.
    """
    shared = {
        "format": form,
        "climbplan_version": origin.climbplan_version or climbplan.__version__,
        "created": origin.created or datetime.now(UTC).isoformat(timespec="seconds"),
        "name": origin.name,
        "spec": origin.spec_text,
        "spec_sha256": origin.spec_sha256,
    }
    for name, text in {**shared, **texts}.items():
        write_text(file, name, text)
    file.attrs["format_version"] = version
    file.attrs["seed"] = origin.seed
    file.attrs["verified"] = np.bool_(origin.verified)
    for name, number in numbers.items():
        if number is not None:
            file.attrs[name] = float(number)
    for name, value in objects.items():
        write_json(file, name, value)


def write_header(
    file: h5py.File,
    plan: PlanHeader,
    form: str,
    version: int,
    *,
    texts: Mapping[str, str],
    numbers: Mapping[str, float | None],
    objects: Mapping[str, Any] | None = None,
) -> None:
    """Write the root attributes of a plan: those of `write_root`, its run and its messages."""
    run_facts = {name: dict(vars(plan)[name]) for name in ("timings", "solvers", "sizes")}
    write_root(
        file,
        plan,
        form,
        version,
        texts=texts,
        numbers=numbers,
        objects=run_facts | dict(objects or {}),
    )
    for name in ("warnings", "notes", "summary"):
        write_dataset(file, name, vars(plan)[name], _WORDS)


def read_root(reader: Reader) -> dict[str, Any]:
    """Return the fields of `Origin`, by name."""
    return {
        "name": reader.text("", "name"),
        "spec_text": reader.text("", "spec"),
        "spec_sha256": reader.text("", "spec_sha256"),
        "seed": reader.integer("", "seed"),
        "verified": reader.flag("", "verified"),
        "created": reader.text("", "created"),
        "climbplan_version": reader.text("", "climbplan_version"),
    }


def read_header(
    reader: Reader, timings: Sequence[str] = (), sizes: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the fields of `PlanHeader`, by name; timings, sizes: entries that have to be there.

    To be read last: what of the whole file is not finite is among them.
    """
    return {
        **read_root(reader),
        "timings": reader.figures("timings", timings),
        "solvers": reader.words("solvers"),
        "sizes": reader.mapping("sizes", sizes),
        "warnings": reader.texts("warnings", _WORDS),
        "notes": reader.texts("notes", _WORDS) if reader.has("notes") else (),
        "summary": reader.texts("summary", _WORDS),
        "not_finite": tuple(reader.not_finite),
    }


def read_status(reader: Reader, allowed: Sequence[str]) -> str:
    """Return the status of a plan; raises PlanFileError for one that its kind does not have."""
    status = reader.text("", "status")
    if status not in allowed:
        raise reader.refuse(f"status {status!r}, expected one of {', '.join(allowed)}")
    return status


def require_finite(path: Path, plan: PlanHeader) -> None:
    """Raise PlanFileError for a plan with NaN or infinities where numbers must be."""
    if plan.not_finite:
        names = ", ".join(plan.not_finite[:_LISTED])
        more = len(plan.not_finite) - _LISTED
        raise PlanFileError(
            f"{path}: NaN or infinity in {names}{f' and {more} more' if more > 0 else ''}"
        )


def require_plan(reader: Reader, version: int, *formats: str) -> None:
    """Raise PlanFileError unless the file is a plan of one of these formats and this version."""
    if not reader.has_attribute("", "format"):
        raise reader.refuse("HDF5, but not a climbplan file (no attribute `format`)")
    stored_format = reader.text("", "format")
    if stored_format not in formats:
        expected = " or ".join(repr(form) for form in formats)
        raise reader.refuse(f"holds {stored_format!r}, expected {expected}")
    _require_version(reader, version)


def require_other(reader: Reader, version: int, form: str, what: str) -> None:
    """Raise PlanFileError unless the file is `what`, of this format and version."""
    if not reader.has_attribute("", "format") or reader.text("", "format") != form:
        raise reader.refuse(f"not {what} ({form})")
    _require_version(reader, version)


def _require_version(reader: Reader, version: int) -> None:
    stored_version = reader.integer("", "format_version")
    if stored_version != version:
        newer = "; a newer climbplan reads it" if stored_version > version else ""
        raise reader.refuse(f"format version {stored_version}, expected {version}{newer}")
