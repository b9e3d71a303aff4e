"""The point of a friction cone's surface that is nearest to a force in a metric."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.statics.compiling import compiled
from climbplan.climb.simulation.statics.small_algebra import _cross, _dot, _times

_EDGES, _SECTIONS, _GOLDEN = 12, 22, (np.sqrt(5.0) - 1) / 2


@compiled
def _nearest_edge(
    tried: Array,
    normal: Array,
    mu: float,
    soft: Array,
    first: Array,
    second: Array,
    edge: Array,
    room: Array,
) -> None:
    """Edge of a friction cone's surface nearest to a force in a metric (3, 3), and there the point.

    Along an edge d = n + mu e the nearest point is d (d C f) / (d C d): the best edge has the
    largest (d C f)^2 / (d C d). Found by comparing _EDGES of them and then by golden section.
    """
    a = 0 if abs(normal[0]) < 0.6 else 1
    for i in range(3):
        first[i] = (1.0 if i == a else 0.0) - normal[a] * normal[i]
    size = np.sqrt(_dot(first, first))
    for i in range(3):
        first[i] /= size
    _cross(normal, first, second)
    best, most = 0.0, -np.inf
    for k in range(_EDGES):
        angle = 2 * np.pi * k / _EDGES
        worth = _worth(angle, tried, normal, mu, soft, first, second, edge, room)
        if worth > most:
            best, most = angle, worth
    low, high = best - 2 * np.pi / _EDGES, best + 2 * np.pi / _EDGES
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    a_left = _worth(left, tried, normal, mu, soft, first, second, edge, room)
    a_right = _worth(right, tried, normal, mu, soft, first, second, edge, room)
    for _ in range(_SECTIONS):
        if a_left > a_right:
            high, right, a_right = right, left, a_left
            left = high - _GOLDEN * (high - low)
            a_left = _worth(left, tried, normal, mu, soft, first, second, edge, room)
        else:
            low, left, a_left = left, right, a_right
            right = low + _GOLDEN * (high - low)
            a_right = _worth(right, tried, normal, mu, soft, first, second, edge, room)
    _worth((low + high) / 2, tried, normal, mu, soft, first, second, edge, room)


@compiled
def _worth(
    angle: float,
    tried: Array,
    normal: Array,
    mu: float,
    soft: Array,
    first: Array,
    second: Array,
    edge: Array,
    room: Array,
) -> float:
    """How near the edge at an angle comes; the point on it is left in `edge`."""
    co, si = mu * np.cos(angle), mu * np.sin(angle)
    for i in range(3):
        edge[i] = normal[i] + co * first[i] + si * second[i]
    _times(soft, edge, room)
    met, own = _dot(room, tried), _dot(room, edge)
    if not (met > 0.0 and own > 0.0):
        return -1.0
    for i in range(3):
        edge[i] *= met / own
    return float(met * met / own)
