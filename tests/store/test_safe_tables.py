"""Texts that a spreadsheet would compute, and names that mean something elsewhere."""

from __future__ import annotations

import io

import numpy as np
import pytest
from pydantic import ValidationError

from climbplan.errors import UnsoundPlan
from climbplan.exports.motion import require_increasing
from climbplan.schema.base import is_name
from climbplan.schema.terrain.terrain import BoxSpec
from climbplan.store.csv_file import write_csv


def test_cells_that_spreadsheets_compute() -> None:
    out = io.StringIO()
    write_csv(out, ("name", "=x"), [("@sum", -1.5), ("-2.5", 1e-3), ("+a", 0.0), ("a=b", 1.0)])
    rows = ["name,'=x", "'@sum,-1.5", "-2.5,0.001", "'+a,0.0", "a=b,1.0"]
    assert out.getvalue().splitlines() == rows


@pytest.mark.parametrize("name", ["LF", "left step's lower edge", "RM 1 high", "\u00e9cart", "1"])
def test_names(name: str) -> None:
    assert is_name(name)
    assert BoxSpec(name=name, lower=(0, 0, 0), upper=(1, 1, 1)).name == name


@pytest.mark.parametrize("name", ["", "=1+1", "@x", "<b>", " a", "a\n", "a\x1b[2J", "-a", "../a"])
def test_what_is_no_name(name: str) -> None:
    assert not is_name(name)
    with pytest.raises(ValidationError):
        BoxSpec(name=name, lower=(0, 0, 0), upper=(1, 1, 1))


@pytest.mark.parametrize("time", [[0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0]])
def test_times_that_do_not_increase(time: list[float]) -> None:
    with pytest.raises(UnsoundPlan, match="expected times that increase"):
        require_increasing(np.array(time))
    require_increasing(np.array([0.0, 1.0]))
