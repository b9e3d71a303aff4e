"""Variables and constraints of a nonlinear program as they are added, for IPOPT through CasADi."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from climbplan.limms.scene import Array


@dataclass
class Unknowns:
    """Variables and constraints as they are added."""

    x: list[ca.MX] = field(default_factory=list)
    start: list[Array] = field(default_factory=list)
    low: list[Array] = field(default_factory=list)
    high: list[Array] = field(default_factory=list)
    g: list[ca.MX] = field(default_factory=list)
    g_low: list[Array] = field(default_factory=list)
    g_high: list[Array] = field(default_factory=list)

    def variable(
        self, name: str, start: float | Array, low: float | Array, high: float | Array
    ) -> ca.MX:
        value = np.atleast_1d(np.asarray(start, float))
        symbol = ca.MX.sym(name, len(value))
        self.x.append(symbol)
        self.low.append(np.broadcast_to(low, value.shape))
        self.high.append(np.broadcast_to(high, value.shape))
        self.start.append(np.clip(value, self.low[-1], self.high[-1]))
        return symbol

    def add(self, expression: ca.MX, low: float | Array, high: float | Array) -> None:
        size = expression.numel()
        self.g.append(ca.vec(expression))
        self.g_low.append(np.broadcast_to(np.asarray(low, float), (size,)))
        self.g_high.append(np.broadcast_to(np.asarray(high, float), (size,)))

    def equal(self, expression: ca.MX) -> None:
        self.add(expression, 0.0, 0.0)
