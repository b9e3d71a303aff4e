"""The distribution of terrains that a spec describes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.climb.envelopes.terrains import TerrainDistribution, select_distribution
from climbplan.climb.schema.envelopes import EnvelopeTerrainSpec
from climbplan.robots.model import Robot
from climbplan.robots.task_robot import with_stance


def build_distribution(spec: EnvelopeTerrainSpec, robot: Robot) -> TerrainDistribution:
    """Return a named distribution with the spec's limbs and ranges."""
    return replace(
        select_distribution(spec.distribution, with_stance(robot, spec.stance), spec.limbs),
        tilt=float(np.deg2rad(spec.tilt_deg)),
        jitter=spec.jitter,
        half_size=spec.half_size,
    )
