"""Feet of finite size keep out of all that is solid: they touch it, and no more.

Links narrow to their toes where they stand; what is round the toe is looked at here, at the surface
that it stands on as at everything beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.climb.check.distances import chain_distance
from climbplan.climb.check.raw_distances import distances
from climbplan.climb.check.subject import Subject
from climbplan.plans.check import Array, Check, judge_worst
from climbplan.terrain.surfaces import Tube

_TOLD = 0.05  # [m] room beside feet up to which it is measured


def feet_check(subject: Subject) -> Iterator[Check]:
    """At the instants; nothing for point toes."""
    yield from judge_feet("limbs.feet", subject, subject.plan.instants.toes, subject.at)


def judge_feet(
    name: str, subject: Subject, toes: Array, moment: Callable[[int], str]
) -> Iterator[Check]:
    """A check of feet round toes (P, N, 3), world; `moment` describes a row."""
    foot, terrain = subject.plan.robot.foot, subject.plan.terrain
    if foot is None:
        return
    enough = foot.radius + _TOLD
    points = np.stack([toes, toes], axis=-2)
    names = [solid.name for solid in subject.solids]
    room = [chain_distance(points, solid, enough)[..., 0] for solid in subject.solids]
    for surface in terrain.surfaces:
        if isinstance(surface, Tube):
            names.append(surface.name)
            away = np.linalg.norm(toes[..., :2] - surface.center, axis=-1)
            room.append(surface.wall - away)
    if terrain.scan is not None:  # which regions lie so near, at most
        places, number = np.unique(toes.reshape(-1, 3), axis=0, return_inverse=True)
        away = distances(places, places, terrain.scan.corners, enough)[number.reshape(-1)]
        names.append("the scan")
        room.append(away.reshape(toes.shape[:-1]) + terrain.scan.flatness)
    if not room:
        yield judge_worst(name, np.zeros(1), lambda _: "", margin="nothing is solid")
        return
    least = np.stack(room, axis=-1)

    def where(p: int, limb: int, solid: int) -> str:
        return f"{moment(p)}, foot of {subject.limb(limb)} and {names[solid]}"

    deep = max(-1e3 * float((least - foot.radius).min()), 0.0)
    margin = f"feet of {1e3 * foot.radius:.0f} mm at most {deep:.2f} mm deep"
    yield judge_worst(name, foot.radius - least, where, margin)
