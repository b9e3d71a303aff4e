"""Whether an envelope's box holds a point of problem P, or of P without its bilinear rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.envelopes.first_stage import FirstStage
from climbplan.climb.envelopes.search import least_error, without_products
from climbplan.learning.envelope_box import Envelope
from climbplan.program.instance import Instance
from climbplan.solvers.ipopt.instances import solve_ipopt

_TIME = 2.0  # [s]


def _within(stage: FirstStage, envelope: Envelope) -> Instance | None:
    box = stage.box(envelope.lower, envelope.upper)
    if box is None:
        return None
    return replace(stage.instance, lower=box.lower, upper=box.upper)


def holds_point(stage: FirstStage, envelope: Envelope, x: Array | None = None) -> bool:
    """Whether a point of P was found in the box; False proves nothing.

    x: a point of P1 to start from, found if left out.
    """
    if x is None:
        x = stage.solve(envelope.lower, envelope.upper, (envelope.lower + envelope.upper) / 2)
    boxed = _within(stage, envelope)
    if x is None or boxed is None:
        return False
    return solve_ipopt(boxed, start=x, time_limit=_TIME).x is not None


def holds_linear_point(stage: FirstStage, envelope: Envelope) -> bool:
    """Whether P without its bilinear rows has a point in the box: a linear program, so exact."""
    boxed = _within(stage, envelope)
    if boxed is None:
        return False
    nothing = np.zeros(0)
    return least_error(without_products(boxed), nothing, np.zeros(0, np.int64)) is not None
