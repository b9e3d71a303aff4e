"""Statements of `specs/` that benchmarks solve: the same ones that users read."""

from __future__ import annotations

from functools import cache
from importlib.resources import as_file
from importlib.util import module_from_spec, spec_from_file_location
from typing import Any

from climbplan.schema.examples import locate_example_resource


@cache
def shipped_cart_pole() -> Any:
    """The module of `specs/cart_pole.py`: a cart-pole between soft walls."""
    with as_file(locate_example_resource("cart_pole.py")) as path:
        found = spec_from_file_location("climbplan_shipped_cart_pole", path)
        assert found is not None
        assert found.loader is not None
        module = module_from_spec(found)
        found.loader.exec_module(module)
    return module
