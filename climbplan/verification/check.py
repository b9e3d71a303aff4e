"""What a check is, and the limit of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array


@dataclass(frozen=True)
class Limit:
    """The largest residual a check lets pass."""

    value: float
    unit: str
    meaning: str


# Residuals of equations are absolute values; those of bounds are signed, below zero inside.
LIMITS = {
    "file.spec_hash": Limit(0, "", "sha256 of the spec's text is the stored one"),
    "file.finite": Limit(0, "", "entries that are NaN, infinite or beyond 1e60"),
    "robot.data": Limit(0, "", "robot values out of their range"),
    "terrain.data": Limit(0, "", "terrain values out of range or at odds with the corners"),
    "limits.data": Limit(0, "", "bounds and safety factors out of their range"),
    "file.spec_values": Limit(1e-6, "", "bounds, loads and terrain are those of the spec"),
    "robot.spec": Limit(1e-9, "", "the robot is the one that the spec names (relative)"),
    "terrain.spec": Limit(1e-9, "", "the terrain is the one that the spec makes (relative)"),
    "file.objective": Limit(1e-4, "", "the objective is the cost of the stored postures"),
    "force.penetration": Limit(
        1e-6, "m", "joints bend towards the surfaces that toes stand on, to first order"
    ),
    "gait.sequence": Limit(1e-6, "m", "instants follow from the rounds and the gait"),
    "steps.com": Limit(1e-6, "m", "body steps within their bounds"),
    "steps.toe": Limit(1e-6, "m", "toe steps within their bounds"),
    "steps.rotation": Limit(1e-6, "rad", "turns within their bound"),
    "goal.position": Limit(1e-6, "m", "the last posture is within tolerance of the goal"),
    "goal.rotation": Limit(
        1e-6, "rad", "the last rotation is within tolerance of the goal about each axis"
    ),
    "contact.region": Limit(1e-6, "m", "toes lie on their surfaces"),
    "contact.allowed": Limit(0, "", "toes on surfaces their limb may not use"),
    "contact.normal": Limit(1e-6, "", "normals are those of the surfaces"),
    "contact.friction": Limit(1e-9, "", "friction coefficients are those of the surfaces"),
    "kinematics.forward": Limit(1e-6, "m", "forward kinematics of the joint angles give the toes"),
    "kinematics.joint_bounds": Limit(1e-6, "rad", "joint angles and commands within their bounds"),
    "force.equilibrium": Limit(1e-6, "of weight", "forces and moments balance (moments at 1 m)"),
    "force.unilateral": Limit(1e-6, "of weight", "no limb pulls on its surface"),
    "force.friction": Limit(1e-6, "of weight", "tangential force within mu f_n / S_mu"),
    "force.without_contact": Limit(1e-9, "of weight", "no force on lifted limbs"),
    "torque.from_forces": Limit(
        1e-6, "N m", "joint torques are J^T f (with grippers, and of the wrists' moments)"
    ),
    "torque.limit": Limit(1e-6, "of limit", "torques within the limit over S_tau"),
    "stiffness.force_deflection": Limit(
        1e-6, "m", "J k^-1 J^T f / (1 - share) = d_wall - [I P^T] d_com"
    ),
    "stiffness.joint_command": Limit(1e-6, "m", "J (joint angles - commands) = d_wall"),
    "stiffness.toe_command": Limit(1e-9, "m", "toe commands are where joint commands put toes"),
    "safety.stored": Limit(1e-6, "", "stored safety factors are those of the stored forces"),
    "static.pose": Limit(1e-4, "m, rad", "the joint commands hold the body at its planned pose"),
    "static.torque": Limit(
        1e-4, "of limit", "torques in that equilibrium within the limit over S_tau"
    ),
    "static.friction": Limit(
        1e-4, "of weight", "tangential forces in that equilibrium within mu f_n / S_mu"
    ),
    "static.stability": Limit(0, "", "the body does not buckle under the forces that hold it"),
    "robust.normal_force": Limit(0, "N", "normal forces of toes in contact keep their margin"),
    "robust.friction": Limit(
        0, "N", "toes hold with so much less normal force, within mu f_n / S_mu"
    ),
    "robust.slip": Limit(0, "", "toes stay where the surface lacks so much of its friction"),
    "robust.depth": Limit(0, "m", "free toes would be commanded so far inside their surfaces"),
    "robust.torque": Limit(0, "", "motors of limbs in contact have so much of their limits left"),
    "robust.stiffness": Limit(0, "", "bracing leaves the body so much of its stiffness"),
    "body.clearance": Limit(1e-6, "m", "the body hull keeps its distance from all solids"),
    "body.free_region": Limit(1e-6, "m", "the body hull ends every round in stated free space"),
    "limbs.axis_collision": Limit(1e-3, "m", "depth of link axes inside solids at the instants"),
    "limbs.collision": Limit(
        1e-6, "m", "links, as capsules, miss obstacles and surfaces at the instants"
    ),
    "limbs.self_collision": Limit(1e-6, "m", "links miss other limbs and the body at the instants"),
    "trajectory.rate": Limit(1e-9, "s", "samples at a fixed rate"),
    "trajectory.endpoints": Limit(
        1e-6, "m", "the path begins at the first posture and ends at the last"
    ),
    "trajectory.sequence": Limit(0, "", "limbs lift and land in the order of the instants"),
    "trajectory.body": Limit(1e-6, "m", "the body keeps to its path and to the gait"),
    "trajectory.command": Limit(1e-5, "m, rad", "joint commands hold the body on its path"),
    "trajectory.friction": Limit(1e-4, "of weight", "tangential forces on the way within mu f_n"),
    "trajectory.torque": Limit(1e-4, "of limit", "torques on the way within the limit"),
    "trajectory.instants": Limit(1e-3, "m, rad", "body and joint commands pass every instant"),
    "trajectory.joint_bounds": Limit(1e-6, "rad", "commanded and standing angles within bounds"),
    "speed.limit": Limit(1e-6, "rad/s", "joint speeds within their limits"),
    "trajectory.reach": Limit(1e-6, "m", "standing toes stay within reach of the moving body"),
    "trajectory.axis_collision": Limit(1e-3, "m", "depth of link axes inside solids on the way"),
    "trajectory.collision": Limit(
        1e-6, "m", "links, as capsules, miss obstacles and surfaces on the way"
    ),
    "trajectory.self_collision": Limit(1e-6, "m", "links miss other limbs and the body on the way"),
}

# Made beside these where the spec lets the body leave its straight way (`steps.com_shift_max`).
SHIFT_LIMITS = {
    "steps.shift": Limit(1e-6, "m", "the body, at lifts, off its straight way as far as it may"),
}

# Made beside these for motions that are timed by their dynamics (`trajectory.pace`).
PACE_LIMITS = {
    "trajectory.dynamics": Limit(
        1e-6, "of weight, limit", "stored forces and torques move the links, by inverse dynamics"
    ),
}

# Made beside these where worlds are counted: for `risk` or `uncertainty`, and by `--worlds`.
RISK_LIMITS = {
    "robust.risk": Limit(1e-9, "", "falls counted in worlds are within the interval that is told"),
    "robust.worlds": Limit(1e-9, "", "the stored Wilson interval is that of the worlds counted"),
    "robust.recount": Limit(0.01, "of worlds", "falls counted again are those stored"),
}

# Made beside these where the terrain is from a scan.
SCAN_LIMITS = {
    "scan.toes": Limit(1e-6, "m", "standing feet within the flatness of the raw surface"),
    "scan.grips": Limit(1e-3, "rad", "gripped sides of the raw surface within the fingers"),
    "scan.friction": Limit(1e-6, "of weight", "forces within friction of the raw normals"),
    "scan.body": Limit(1e-6, "m", "the body hull keeps its distance from raw triangles"),
    "scan.limbs": Limit(1e-6, "m", "links, as capsules, miss raw triangles but at toes"),
    "scan.trajectory": Limit(1e-6, "m", "links, as capsules, miss raw triangles on the way"),
}

# Made beside these for feet of finite size. Lifting and setting down, a foot may go into a surface
# as deep as links may: joints turn evenly between samples.
FEET_LIMITS = {
    "limbs.feet": Limit(1e-6, "m", "feet of finite size touch what is solid, and no more"),
    "trajectory.feet": Limit(1e-3, "m", "feet of finite size touch no more than that on the way"),
}

# Made beside these for flat feet.
SOLE_LIMITS = {
    "force.corners": Limit(1e-9, "of weight", "forces at corners of soles add up to feet's forces"),
    "force.soles": Limit(1e-6, "m", "centres of pressure inside soles"),
    "trajectory.soles": Limit(1e-4, "m", "centres of pressure inside soles on the way"),
    "robust.sole": Limit(0, "", "centres of pressure inside soles by so much of their half sizes"),
}

# Made beside these for robots with grippers; no friction cones at their toes then.
GRIP_LIMITS = {
    "grip.data": Limit(0, "", "grippers, holds and model of spines out of their range"),
    "grip.model": Limit(1e-9, "", "the model of spines is the one that is named (relative)"),
    "grip.spines": Limit(1e-6, "N", "spines count at the model's lower confidence bound"),
    "grip.unilateral": Limit(1e-6, "of weight", "no palm or finger pulls on what it touches"),
    "grip.shear": Limit(1e-6, "of weight", "shear within (mu f_n + spines) / S_mu, by finger"),
    "grip.force": Limit(1e-6, "N", "gripping force within its limit over S_tau"),
    "grip.moment": Limit(1e-6, "N m", "no moment about the fingers' axis, none without contact"),
    "grip.apart": Limit(1e-6, "m", "grippers that hold on, as thick as limbs, do not overlap"),
    "grip.pull_out": Limit(1e-6, "of weight", "the stored pull-out margins are those of the grips"),
    "robust.pull": Limit(0, "N", "grips hold so much further pull, without S_mu"),
    "wrist.alignment": Limit(1e-6, "", "wrists hold grippers square on their holds"),
    "wrist.bounds": Limit(1e-6, "rad", "wrist angles within their bounds"),
    "wrist.from_forces": Limit(1e-6, "N m", "wrist torques are those of forces and moments"),
    "wrist.torque": Limit(1e-6, "of limit", "wrist torques within the limit over S_tau"),
    "trajectory.grip_shear": Limit(
        1e-4, "of weight", "shear of palms and fingers on the way is held"
    ),
    "trajectory.contact_force": Limit(1e-4, "of weight", "stored forces are those of commands"),
    "trajectory.grip_force": Limit(1e-4, "N", "gripping force on the way within its limit"),
    "trajectory.wrist_torque": Limit(1e-4, "of limit", "wrist torques on the way within limits"),
    "trajectory.wrist_bounds": Limit(1e-6, "rad", "wrist angles on the way within bounds"),
}

# All checks of climbs and transitions.
CLIMB_LIMITS = (
    LIMITS
    | SHIFT_LIMITS
    | PACE_LIMITS
    | RISK_LIMITS
    | GRIP_LIMITS
    | SCAN_LIMITS
    | FEET_LIMITS
    | SOLE_LIMITS
)


@dataclass(frozen=True)
class LeftOut:
    """Something that a plan needs in the world and no check of it holds."""

    model: str  # what the plan is verified in instead, for its badge: "forward Euler"
    words: str  # what that leaves out, with a figure: "attitude off by 2.7 rad between knots"


@dataclass(frozen=True)
class Check:
    """One statement looked at: its worst residual, and where in the climb it is.

    One that is not judged tells its figure and decides nothing: `passed` is then True.
    """

    name: str
    residual: float
    limit: float
    unit: str
    passed: bool
    margin: str  # what is left in the robot's terms ("S_mu 1.80"), empty for equations
    worst_at: str  # "round 3, LM lifted, RF"
    used: float = 0.0  # part of a bound that is used up, 1 at the bound; 0 for equations
    judged: bool = True
    left_out: LeftOut | None = None  # what the plan lacks where this is not judged, or not whole
    fragile: str = ""  # where and by how much a margin is not kept, in the robot's terms
    holds: float | None = None  # what bears the worst load holds, and
    needed: float | None = None  # what is asked of it, in the check's unit: of loads of hardware

    @property
    def mark(self) -> str:
        """Return how it went, in a word: "passed", "failed" or "not judged"."""
        if not self.passed:
            return "failed"
        return "passed" if self.judged else "not judged"

    @property
    def rank(self) -> int:
        """Order in tables: failed checks first, then those that are not judged."""
        return ("failed", "not judged", "passed").index(self.mark)

    @property
    def severity(self) -> float:
        """Residual in units of the limit; infinite for NaN and for any excess over a zero limit."""
        if math.isnan(self.residual):
            return math.inf
        if self.limit == 0:
            return math.inf if self.residual > 0 else 0.0
        return self.residual / self.limit

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; a residual that is not finite becomes None."""
        return {
            "name": self.name,
            "residual": self.residual if math.isfinite(self.residual) else None,
            "limit": self.limit,
            "unit": self.unit,
            "passed": self.passed,
            "judged": self.judged,
            "result": self.mark,
            "margin": self.margin,
            "worst_at": self.worst_at,
            "used": self.used if math.isfinite(self.used) else None,
            **{
                name: value if math.isfinite(value) else None
                for name, value in (("holds", self.holds), ("needed", self.needed))
                if value is not None
            },
        }


def judge(
    name: str, residual: float, worst_at: str = "", margin: str = "", used: float = 0.0
) -> Check:
    """Return a check by its name in the tables of limits; NaN never passes."""
    limit = CLIMB_LIMITS[name]
    residual = float(residual) + 0.0  # no minus zero
    passed = bool(residual <= limit.value)  # False for NaN
    return Check(name, residual, limit.value, limit.unit, passed, margin, worst_at, float(used))


def mark_unjudged(check: Check, reason: str, model: str = "", details_text: str = "") -> Check:
    """Return a check whose figure is told but decides nothing.

    model, words: of what the plan lacks without it, which counts only where the figure is beyond
    the check's limit. `words` may hold `{figure}`, which becomes margin or residual.
    """
    figure = check.margin or f"{check.residual:.2g} {check.unit}".rstrip()
    lacks = model and not check.residual <= check.limit
    return replace(
        check,
        passed=True,
        judged=False,
        used=0.0,
        margin=f"not judged ({reason}): {figure}",
        left_out=LeftOut(model, details_text.format(figure=figure)) if lacks else None,
    )


def mark_not_compared(check: Check, margin: str, model: str, details_text: str) -> Check:
    """Return a check that the file alone does not allow: what it would compare is the plan's own
    word.
    """
    lacks = LeftOut(model, details_text)
    return replace(check, judged=False, margin=f"not compared, {margin}", left_out=lacks)


def judge_worst(
    name: str,
    residuals: Array,
    where: Callable[..., str],
    margin: str = "",
    used: Array | None = None,
) -> Check:
    """Return a check over many places; NaN anywhere counts as the worst.

    residuals: any shape; used: what part of a bound each place uses up, of the same shape.
    `where` is called with the indices of the worst place: of the largest residual or, while the
    check passes, of the largest part used.
    """
    worst = np.unravel_index(int(np.argmax(residuals)), residuals.shape)
    check = judge(name, residuals[worst], margin=margin)
    if check.passed and used is not None:
        worst = np.unravel_index(int(np.argmax(used)), used.shape)
        check = replace(check, used=float(used[worst]))
    if check.residual == 0 and used is None:
        return check  # nothing is worse than anything else
    return replace(check, worst_at=where(*(int(i) for i in worst)))


def check_faults(name: str, faults: Sequence[str]) -> Check:
    """Return a check that counts faults and names the first."""
    return judge(name, float(len(faults)), faults[0] if faults else "")
