"""Algorithm 3: both blocks in turn, weights growing, residuals of eq. (6.13) recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.copies import Copy, Found, Modes
from climbplan.limms.consensus.mixed_integer import NEAR_GOAL, MixedInteger
from climbplan.limms.consensus.nonlinear import Nonlinear
from climbplan.limms.consensus.projection import Projection
from climbplan.limms.consensus.setting import HELD, Setting, chain_points
from climbplan.program.residuals import BlockResidual

GOOD = (0.01, 0.01, 0.1)  # [m], [m], [rad] mean residuals to reach
LATCHED = 1e-4  # [m] by which latches of an iterate may be off
FREE = 150  # looks of HiGHS in a mixed-integer block with free integers beside a consensus
_FRAMES = np.array([0, 0, 1, 2, 2, 3, 3, 3])  # straight link along the z axis of each frame


@dataclass(frozen=True)
class Residual:
    """Disagreement of the blocks, eq. (6.13): means and largest values."""

    box: tuple[float, float]  # r_pB [m]
    points: tuple[float, float]  # r_pL [m]
    axes: tuple[float, float]  # r_RL [rad]

    @property
    def good(self) -> bool:
        """Whether the means are where they should be."""
        means = (self.box[0], self.points[0], self.axes[0])
        return all(value <= limit for value, limit in zip(means, GOOD, strict=True))


@dataclass(frozen=True)
class Step:
    """Record of one iteration."""

    residual: Residual
    violation: float  # of the nonlinear block [m]
    penetration: float  # of its links [m]
    missed: float  # of the goal by the mixed-integer block [m]
    mixed_integer_seconds: float
    nonlinear_seconds: float
    frozen: bool


@dataclass(frozen=True)
class Iterate:
    """What the blocks agreed on best."""

    number: int
    modes: Modes
    copy: Copy  # of the nonlinear block
    angles: Array
    velocity: Array  # of the box, from the mixed-integer block
    held_seconds: float  # [s] of an interval in which the box is held
    residual: Residual
    violation: float
    off: BlockResidual | None  # the rows that the mixed-integer block's answer is furthest off

    def rank(self) -> tuple[bool, float]:
        """Smaller is better: latches that hold first, then agreement."""
        r = self.residual
        return (self.violation > LATCHED, r.box[0] + r.points[0] + 0.1 * r.axes[0])


def residual_of(setting: Setting, one: Copy, other: Copy) -> Residual:
    """Eq. (6.13) of two copies; the start, which both have, is left out.

    Frames differ in their z axes, which points fix: the mixed-integer block leaves the others
    free, so that they are as the nonlinear block has them.
    """
    module = setting.scene.module
    box = np.linalg.norm(one.box[1:] - other.box[1:], axis=-1)
    gone = chain_points(one.points[1:], module) - chain_points(other.points[1:], module)
    points = np.linalg.norm(gone, axis=-1)
    axes = np.linalg.norm(_axes(setting, one) - _axes(setting, other), axis=-1)[..., _FRAMES]
    return Residual(
        *((float(values.mean()), float(values.max())) for values in (box, points, axes))
    )


def _axes(setting: Setting, copy: Copy) -> Array:
    """Directions (K, L, 4, 3) of links."""
    found: Array = np.diff(copy.points[1:], axis=2) / setting.links[:, None]
    return found


@dataclass(frozen=True)
class Parameters:
    """Of Algorithm 3, as the spec gives them."""

    iterations: int
    growth: float  # rho
    weight: float  # W^0 of both blocks
    freeze_after: int  # iterations with free integers


@dataclass(frozen=True)
class Agreement:
    """How the iterations from one choice of integers went."""

    steps: tuple[Step, ...]
    best: Iterate


def agree(
    block: MixedInteger,
    nonlinear: Nonlinear,
    first: Found,
    parameters: Parameters,
    deadline: float,
    report: Callable[[float], None] = lambda share: None,
) -> Agreement | None:
    """Algorithm 3 from a first answer of the mixed-integer block; None without time for a step.

    The integers are frozen after `freeze_after` iterations (in the published form never), if the
    block reaches the goal with them: a poor incumbent would be polished far from it. Ends early
    where the blocks agree to a tenth of what is asked for. deadline: `time.monotonic` [s], a cap.
    """
    setting = block.setting
    weight, found = parameters.weight, first
    assert first.copy is not None
    dual = first.copy.scaled(0.0)
    steps: list[Step] = []
    best: Iterate | None = None
    frozen: Projection | None = None
    for number in range(parameters.iterations):
        assert found.copy is not None
        assert found.modes is not None
        assert found.velocity is not None
        bent = nonlinear.solve(found.copy.moved(dual, 1.0), found.modes, deadline)
        if not np.isfinite(bent.violation):
            break  # the time limit fell into it
        residual = residual_of(setting, found.copy, bent.copy)
        steps.append(
            Step(
                residual,
                bent.violation,
                bent.penetration,
                found.missed,
                found.seconds,
                bent.seconds,
                frozen is not None,
            )
        )
        iterate = Iterate(
            len(steps),
            found.modes,
            bent.copy,
            bent.angles,
            found.velocity,
            setting.form.seconds[HELD],
            residual,
            max(bent.violation, bent.penetration),
            found.off,
        )
        if best is None or iterate.rank() < best.rank():
            best = iterate
        report((number + 1) / parameters.iterations)
        if _agreed(residual) or time.monotonic() > deadline:
            break
        # eq. (6.12c), and the dual shrinks as the weights grow
        dual = dual.moved(found.copy, 1.0).moved(bent.copy, -1.0).scaled(1 / parameters.growth)
        weight *= parameters.growth
        late = setting.form.follow and number + 1 >= parameters.freeze_after
        if frozen is None and late and found.missed <= NEAR_GOAL:
            assert found.x is not None
            frozen = Projection(block, found.x)
        target = bent.copy.moved(dual, -1.0)
        if frozen is not None:
            again = frozen.solve(target, weight, bent.region)
        else:
            block.pull(target, weight)
            again = block.solve(FREE, deadline, found.x)
        if again.copy is None:
            break
        found = again
    block.rest()
    return None if best is None else Agreement(tuple(steps), best)


def _agreed(residual: Residual) -> bool:
    means = (residual.box[0], residual.points[0], residual.axes[0])
    return all(value <= limit / 10 for value, limit in zip(means, GOOD, strict=True))
