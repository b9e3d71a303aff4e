"""The table of plan kinds names modules and functions: what it names is there."""

from __future__ import annotations

import inspect
from importlib import import_module
from pkgutil import resolve_name

import pytest

from climbplan.api.kinds import KINDS, PlanKind


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_what_the_table_names_is_there(kind: PlanKind) -> None:
    for module, function, names in (
        (kind.verification, "verify", ["path"]),
        (kind.verification, "verify_and_mark", ["path"]),
        (kind.report, "report_dict", ["path"]),
        (kind.report, "write_report", ["path", "directory", "verification"]),
        (kind.csv, "export_csv", ["path", "out"]),
    ):
        found = vars(import_module(module))[function]
        assert list(inspect.signature(found).parameters)[: len(names)] == names
    if kind.scene_function is not None:
        assert list(inspect.signature(resolve_name(kind.scene_function)).parameters) == ["path"]
