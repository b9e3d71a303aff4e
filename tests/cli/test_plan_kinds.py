"""Each family has the modules and functions that its kind of plan file is read by."""

from __future__ import annotations

import inspect
from importlib import import_module

import pytest

from climbplan.api.kinds import KINDS, PlanKind


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_a_family_has_what_reads_its_files(kind: PlanKind) -> None:
    wanted = [
        ("check.verification", "verify", ["path"]),
        ("check.verification", "verify_and_mark", ["path"]),
        ("pages.report", "build_report", ["path"]),
        ("pages.report", "write_report", ["path", "directory", "verification"]),
        ("pages.report", "write_values", ["path", "directory", "verification"]),
        ("exports.table", "export_csv", ["path", "out"]),
    ]
    if kind.is_in_space:
        wanted.append(("pages.scene", "read_scene", ["path"]))
    if kind.moves:
        wanted.append(("exports.motion", "read_motion", ["path"]))
    for module, function, names in wanted:
        found = vars(import_module(f"climbplan.{kind.family}.{module}"))[function]
        assert list(inspect.signature(found).parameters)[: len(names)] == names
