"""Commands that press inward: a compliant limb then holds its toe on the surface by itself.

A joint that is a spring is commanded beyond its angle by what the contact force bends it. Shear
bends limbs as well, and where it does so away from the surface by more than pressure does towards
it, the commanded toe is off the surface: friction alone holds it there, and a toe that touches
down a little late, or slides once, never finds the surface.
"""

from __future__ import annotations

import numpy as np

from climbplan.climb.check.subject import Subject
from climbplan.verification.check import Check, judge_worst, unjudged


def inward_check(subject: Subject, asked: float | None) -> Check:
    """Depth of commands by n . J (angles - commands) >= asked [m].

    This is to first order, as plans are asked for it; beside it stands how deep the commanded toes
    really are, which is what reports call the depth of commands. Commands outside are told but not
    judged where the spec asks nothing.
    """
    instants, forces = subject.plan.instants, subject.plan.forces
    bent = instants.joint_angles - forces.joint_command
    moved = np.einsum("knij,knj->kni", subject.limbs.jacobian(), bent)
    depth = np.einsum("kni,kni->kn", moved, instants.normal)
    standing = np.where(instants.contact, depth, np.inf)
    outside = int((standing < 0).sum())
    into = np.einsum("kni,kni->kn", instants.toes - forces.toe_command, instants.normal)
    real = np.where(instants.contact, into, np.inf)
    linear, commanded = _millimetres(standing), _millimetres(real)
    margin = f"{linear} inside at least to first order, {commanded} as commanded"
    if outside:
        margin += f", {outside} of {int(instants.contact.sum())} commands outside"
    residual = np.where(instants.contact, (asked or 0.0) - depth, -np.inf)
    check = judge_worst("force.inward", residual, subject.at, margin=margin)
    if asked is not None or check.passed:
        return check
    # Nothing is left out of the plan: what friction has to hold is judged by the static checks.
    return unjudged(check, "force.least_depth is not asked")


def _millimetres(depth: np.ndarray) -> str:
    """The least of depths [m] in words, without "-0.0"."""
    return f"{round(1e3 * float(depth.min(initial=np.inf)), 1) + 0.0:.1f} mm"
