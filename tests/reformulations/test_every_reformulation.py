"""Every reformulation says what it accepts, applies itself, and inverts a point of its form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_programs import random_numbers, small_program

from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.admm import AdmmSplit
from climbplan.reformulations.base import Reformulation
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.disjunctions import BigM, ConvexHull
from climbplan.reformulations.fixed_integers import FixedIntegers
from climbplan.reformulations.local_envelopes import LocalMcCormick
from climbplan.reformulations.mccormick import McCormick
from climbplan.reformulations.slack_relaxation import SlackRelaxation

SMALL = small_program(True).instantiate(random_numbers(np.random.default_rng(0)))
ALL: dict[str, Reformulation[Any]] = {
    "big-m": BigM(),
    "hull": ConvexHull(),
    "mccormick": McCormick(),
    "local": LocalMcCormick(SMALL.lower, SMALL.upper),
    "slacks": SlackRelaxation(),
    "pinned": FixedIntegers.at_point(SMALL, 0.5 * (SMALL.lower + SMALL.upper)),
    "complementarity": Complementarity(),
    "complementarity, big-m": Complementarity(coupling="big-m"),
    "admm": AdmmSplit(),
}


def unbounded() -> Instance:
    """A switched row and a product without bounds."""
    p = Program("open")
    x = p.continuous("x", (2,))
    on = p.binary("on", ())
    p.when("switched", on, x[0], upper=0.0)
    p.between("product", [x[0] * x[1]], -1.0, 1.0)
    return p.instantiate()


def subclasses(kind: type) -> set[type]:
    below = set(kind.__subclasses__())
    return below.union(*(subclasses(one) for one in below))


def test_all_are_here() -> None:
    assert subclasses(Reformulation) == {type(one) for one in ALL.values()}


@pytest.mark.parametrize("name", ALL)
def test_a_form_gives_the_statements_variables_back(name: str) -> None:
    method = ALL[name]
    assert method.accepts(SMALL)
    form = method.apply(SMALL)
    whole = form.form.size if "complementarity" in name else None
    if whole is None:
        whole = (form.relaxed if name == "admm" else form).instance.size
    point = np.random.default_rng(1).uniform(0, 1, whole)
    found = form.invert(point)
    assert found.shape == (SMALL.size,)
    continuous = ~SMALL.integer
    np.testing.assert_array_equal(found[continuous], point[: SMALL.size][continuous])


@pytest.mark.parametrize("name", ALL)
def test_accepts_says_whether_it_applies(name: str) -> None:
    method, instance = ALL[name], unbounded()
    if method.accepts(instance):
        method.apply(instance)
        return
    if name == "local":
        return  # of another dimension
    with pytest.raises(UsageError):
        method.apply(instance)


def test_what_needs_bounds_refuses_a_program_without() -> None:
    refused = {name for name, method in ALL.items() if not method.accepts(unbounded())}
    assert refused == {"big-m", "hull", "mccormick", "local", "pinned", "complementarity, big-m"}
