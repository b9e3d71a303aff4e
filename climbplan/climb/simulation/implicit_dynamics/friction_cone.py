"""Project a force to the surface of a friction cone, in the metric of a compliance matrix."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.simulation.implicit_dynamics.compiling import compiled
from climbplan.climb.simulation.implicit_dynamics.linear_algebra import _apply_matrix, _cross, _dot

_NUM_EDGES, _NUM_SECTIONS, _GOLDEN_RATIO = 12, 22, (np.sqrt(5.0) - 1) / 2


@compiled
def _project_to_cone_surface(
    trial_force: Array,
    normal: Array,
    mu: float,
    compliance: Array,
    tangent: Array,
    binormal: Array,
    cone_force: Array,
    buffer: Array,
) -> None:
    """Find the point of a cone's surface that is nearest to a force f in a metric C (3, 3).

    Along an edge d = n + mu e the nearest point is d (d C f) / (d C d), so the best edge maximises
    (d C f)^2 / (d C d). The maximum is bracketed by _NUM_EDGES edges and refined by golden section.
    The point is left in `cone_force`.
    """
    a = 0 if abs(normal[0]) < 0.6 else 1
    for i in range(3):
        tangent[i] = (1.0 if i == a else 0.0) - normal[a] * normal[i]
    norm = np.sqrt(_dot(tangent, tangent))
    for i in range(3):
        tangent[i] /= norm
    _cross(normal, tangent, binormal)
    best_angle, best_value = 0.0, -np.inf
    for k in range(_NUM_EDGES):
        angle = 2 * np.pi * k / _NUM_EDGES
        value = _evaluate_edge(
            angle, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
        )
        if value > best_value:
            best_angle, best_value = angle, value
    low, high = best_angle - 2 * np.pi / _NUM_EDGES, best_angle + 2 * np.pi / _NUM_EDGES
    left, right = high - _GOLDEN_RATIO * (high - low), low + _GOLDEN_RATIO * (high - low)
    value_left = _evaluate_edge(
        left, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
    )
    value_right = _evaluate_edge(
        right, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
    )
    for _ in range(_NUM_SECTIONS):
        if value_left > value_right:
            high, right, value_right = right, left, value_left
            left = high - _GOLDEN_RATIO * (high - low)
            value_left = _evaluate_edge(
                left, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
            )
        else:
            low, left, value_left = left, right, value_right
            right = low + _GOLDEN_RATIO * (high - low)
            value_right = _evaluate_edge(
                right, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
            )
    _evaluate_edge(
        (low + high) / 2, trial_force, normal, mu, compliance, tangent, binormal, cone_force, buffer
    )


@compiled
def _evaluate_edge(
    angle: float,
    trial_force: Array,
    normal: Array,
    mu: float,
    compliance: Array,
    tangent: Array,
    binormal: Array,
    cone_force: Array,
    buffer: Array,
) -> float:
    """Return (d C f)^2 / (d C d) of the edge d at an angle; leave its point in `cone_force`."""
    co, si = mu * np.cos(angle), mu * np.sin(angle)
    for i in range(3):
        cone_force[i] = normal[i] + co * tangent[i] + si * binormal[i]
    _apply_matrix(compliance, cone_force, buffer)
    force_product, edge_product = _dot(buffer, trial_force), _dot(buffer, cone_force)
    if not (force_product > 0.0 and edge_product > 0.0):
        return -1.0
    for i in range(3):
        cone_force[i] *= force_product / edge_product
    return float(force_product * force_product / edge_product)
