"""What of the robot is inside the terrain, or in another link, at the planned postures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from climbplan.simulation.drake.exported import ExportedMotion
from climbplan.simulation.drake.plant import POINT_RADIUS, Plant

PERIOD = 0.1  # [s] between postures
DEEP = 5e-4  # [m] from which a penetration is named


@dataclass(frozen=True)
class PlannedPenetration:
    """Where a link is deepest in something, as planned."""

    link: str
    other: str  # surface, obstacle or link
    time: float  # [s]
    depth: float  # [m]
    is_toe: bool  # the link stands on a toe there


def find_planned_penetrations(
    plant: Plant, root: Any, motion: ExportedMotion
) -> tuple[PlannedPenetration, ...]:
    """Return the deepest penetration of each pair of link and other, over the planned postures.

    The robot is at the plan's first sample afterwards. Nothing is simulated.
    """
    context = plant.plant.GetMyMutableContextFromRoot(root)
    toes = set().union(*plant.toe_bodies)
    deepest: dict[tuple[str, str], PlannedPenetration] = {}
    next_time = float(motion.time[0])
    for sample, now in enumerate(motion.time):
        if now < next_time and sample < len(motion.time) - 1:
            continue
        next_time = float(now) + PERIOD
        plant.place(context, motion, sample)
        for pair in plant.penetrations(context):
            if pair.depth <= DEEP + (POINT_RADIUS if plant.added_toes else 0.0):
                continue
            solid = plant.terrain.get(pair.id_A) or plant.terrain.get(pair.id_B)
            ends = [plant.body_of(context, geometry) for geometry in (pair.id_A, pair.id_B)]
            if pair.id_A in plant.terrain:
                ends.reverse()
            is_toe = solid is not None and int(ends[0].index()) in toes
            names = (str(ends[0].name()), solid or str(ends[1].name()))
            if names not in deepest or pair.depth > deepest[names].depth:
                deepest[names] = PlannedPenetration(
                    *names, time=float(now), depth=float(pair.depth), is_toe=is_toe
                )
    plant.place(context, motion, 0)
    return tuple(sorted(deepest.values(), key=lambda found: -found.depth))
