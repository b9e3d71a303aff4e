"""Grippers that hold on beside each other do not overlap.

Each is a T, as thick as a limb: from the wrist to the grip's centre, and from finger to finger.
"""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.climb.check.anew.grips import Holds
from climbplan.climb.check.self_collision import segments_apart
from climbplan.climb.check.subject import Subject
from climbplan.robots.gripper import Gripper
from climbplan.verification.check import Check, judge_worst

_TOLD = 0.02  # [m] room up to which it is measured


def grips_apart(subject: Subject, gripper: Gripper, holds: Holds) -> Check:
    """At every instant, of every two limbs that hold on."""
    plan = subject.plan
    instants, names = plan.instants, plan.robot.limb_names
    wrists = instants.toes
    palms = wrists - gripper.length * instants.normal
    fingers = gripper.finger_span / 2 * holds.axis[instants.region]
    parts = (
        np.stack([wrists, palms], axis=2),
        np.stack([palms - fingers, palms + fingers], axis=2),
    )  # (K, N, 2, 3)
    thick = 2 * plan.robot.limb_radius
    pairs = list(itertools.combinations(range(len(names)), 2))
    room = np.full((instants.count, len(pairs)), _TOLD)
    for column, (one, other) in enumerate(pairs):
        both = np.flatnonzero(instants.contact[:, one] & instants.contact[:, other])
        for a, b in itertools.product(parts, parts):
            away = segments_apart(a[both, one], b[both, other], thick + _TOLD) - thick
            room[both, column] = np.minimum(room[both, column], away)

    def where(k: int, column: int) -> str:
        one, other = pairs[column]
        return f"{subject.at(k)}, {names[one]} and {names[other]}"

    least = float(room.min())
    words = "at least " if least >= _TOLD else ""
    return judge_worst("grip.apart", -room, where, f"{words}{1e3 * least:.1f} mm between grippers")
