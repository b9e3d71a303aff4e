"""A bound of motions with the contacts of a known one: how good it is of its own gait.

No integer is left but parts and regions, so that a few rounds of linear programs draw states,
forces and arms together: what is left between this bound and that of all gaits is for contacts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.micp.branch_and_bound import MAX_TIGHTENING_ROUNDS, TANGENT_RATIO
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.prefix_relaxation import TaskRelaxation, bound_by_tightening
from climbplan.walking.micp.variable_bounds import VariableBounds
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.task.task import WalkTask


def bound_of_gait(task: WalkTask, limits: MicpLimits, answers: Sequence[WalkAnswer]) -> float:
    """What motions with the contacts of the cheapest answer cost at least, by forward Euler steps.

    They are within a tube about all answers; the bound is at most the cheapest cost less the gap.
    0 if no answer has a motion.
    """
    known = [(a.objective, a.trajectory) for a in answers if a.trajectory is not None]
    if not known:
        return 0.0
    cost, best = min(known, key=lambda one: one[0])
    stated = replace(task, integrator="euler")
    motions = np.stack([motion.state for _, motion in known])
    tube = build_attitude_box(stated, motions, np.array(limits.angles), np.array(limits.spin))
    pieces = limits.arm_pieces, limits.height_pieces
    program = TaskRelaxation(stated, tube, cost * (1.0 - limits.gap), *pieces, TANGENT_RATIO)
    force = task.body.force_limit / (task.weight / task.body.leg_count)
    box = VariableBounds.create_open(stated, program.cutoff, force).fix_contacts(
        best.gait.contact[:-1]
    )
    end = limits.clock() + limits.seconds
    return bound_by_tightening(
        program, box, MAX_TIGHTENING_ROUNDS, lambda: end - limits.clock(), limits.clock
    )
