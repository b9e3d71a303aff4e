"""The cart-pole as users get it: the statement that is shipped beside its spec."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

_PATH = Path(__file__).parents[2] / "specs" / "cart_pole.py"
_spec = importlib.util.spec_from_file_location("shipped_cart_pole", _PATH)
assert _spec is not None
assert _spec.loader is not None
_module = importlib.util.module_from_spec(_spec)
sys.modules[_spec.name] = _module
_spec.loader.exec_module(_module)

cart_pole = _module.cart_pole
random_theta = _module.random_theta
problem = _module.problem
springs = _module.springs
