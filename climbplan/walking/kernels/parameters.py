"""Arguments of compiled functions: named tuples of arrays, which Numba takes as they are.

L legs, J joints of a leg, N intervals, F free footholds, Z unknowns of the QP.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import NamedTuple

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.walking.task.task import BodyParameters, ToeWorkspace


class LegChain(NamedTuple):
    """The joints of one leg at zero angles, body frame; of all legs with a first axis (L,).

    Joints turn about their axes, or slide along their directions where the axis is zero.
    """

    joint: Array  # (J, 3) positions [m]
    axis: Array  # (J, 3)
    slide: Array  # (J, 3)
    drive: Array  # (J, J) motion of joints by angles of motors
    toe: Array  # (3,) [m]
    posture: Array  # (J,) nominal angles [rad]


class GaitHorizon(NamedTuple):
    """The horizon of a fixed gait."""

    steps: Array  # (N,) lengths of the intervals [s]
    use_mean: bool  # integrator `mean`, else forward Euler
    contact: BoolArray  # (N + 1, L)
    start: Array  # (12,) first state
    workspace_over_stance: bool  # standing toes stay in their boxes until their interval ends


class ToePlacement(NamedTuple):
    """Everything but states and free footholds that decides where toes are."""

    workspace: ToeWorkspace
    foothold: IntArray  # (N + 1, L) index of the free foothold, `HELD` or `SWINGING`
    height: Array  # (N + 1, L) of swinging toes [m]
    start: Array  # (L, 3) toes at the start, world frame [m]
    base: Array  # (F,) heights of footholds are base + tilt spots [m]
    tilt: Array  # (F, 2)


class LinearisationPoint(NamedTuple):
    """An iterate of the sequential QP."""

    state: Array  # (N + 1, 12)
    force: Array  # (N, L, 3) zero for swinging legs [N]
    spots: Array  # (F, 2) free footholds [m]


class ForcedMotion(NamedTuple):
    """States, toes and forces knot by knot; arrays may be longer than the horizon."""

    state: Array  # (N, 12)
    toes: Array  # (N, L, 3) world frame [m]
    force: Array  # (N, L, 3) world frame [N]


class SteppingMotion(NamedTuple):
    """States and toes of a gait with what its swing trajectories are made of."""

    state: Array  # (N + 1, 12)
    toes: Array  # (N + 1, L, 3) world frame [m]
    contact: BoolArray  # (N + 1, L)
    steps: Array  # (N,) lengths of the intervals [s]
    swing_clearance: float  # height of swing trajectories above the higher end [m]


class FootholdUnknowns(NamedTuple):
    """The free footholds as unknowns of the QP."""

    foothold: IntArray  # (N + 1, L) as `ToePlacement.foothold`
    spots: Array  # (F, 2) at the point of linearisation [m]
    tilt: Array  # (F, 2) slope of each foothold's region
    unit: float  # [m] of the unknowns
    first_column: int


class AffineStates(NamedTuple):
    """States as offset + sensitivity z of the unknowns z (Z,)."""

    offset: Array  # (N + 1, 12)
    sensitivity: Array  # (N + 1, 12, Z)


class QpRows(NamedTuple):
    """Rows lower <= rows z <= upper of the QP, written in place."""

    rows: Array  # (M, Z)
    lower: Array  # (M,)
    upper: Array  # (M,)


class QpObjective(NamedTuple):
    """The objective of eq. (8.30)."""

    reference: Array  # (N, 7) height, velocity and angles
    weight: Array  # (7,)
    motion: float  # weight of the body's squared steps
    force_hessian: Array  # (Z, Z) of force differences
    ridge: float  # relative curvature added along the diagonal


class QpLayout(NamedTuple):
    """Columns and units of the unknowns, and the margin of the workspace rows."""

    force_columns: IntArray  # (N + 1,) columns of forces in use up to each knot
    force_unit: float  # [N]
    foot_unit: float  # [m]
    foot_column: int  # first column of footholds
    margin: float  # [m] to the sides of boxes, of toes yet to be placed


class QpProblem(NamedTuple):
    """The fixed-gait program apart from its point of linearisation."""

    body: BodyParameters
    horizon: GaitHorizon
    placement: ToePlacement
    objective: QpObjective
    layout: QpLayout


class QpBuffers(NamedTuple):
    """Arrays that an assembly writes into."""

    after: Array  # (N, 12) states one interval later
    jacobian: Array  # (N, 12 + 6 L, 12) of `after` by state, toes and forces
    states: AffineStates
    hessian: Array  # (Z, Z)
    gradient: Array  # (Z,)
    block: QpRows  # workspace rows
