"""A simulated run held against its plan, instant by instant: torques, friction, sag, slips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.check.anew.feet import foot_arm, rolling
from climbplan.climb.check.anew.soles import lying
from climbplan.climb.check.anew.static_pose import Braced, settle
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.feedforward import links_moment
from climbplan.climb.simulation.control.planned_pressure import planned_pressure
from climbplan.climb.simulation.grips.gripping import gripped
from climbplan.climb.simulation.instants import instant_samples
from climbplan.climb.simulation.replay import Run
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.measures import SLIP, rolled
from climbplan.simulation.motors import motor_stiffness

# Planned torques below [N m], or below a share of the largest planned one, are left out of relative
# errors
LEAST_TORQUE = 1.0
LEAST_TORQUE_SHARE = 0.2
LEAST_SAG = 1e-3  # [m] predicted sags below are left out of relative errors
LOST = 0.5  # [s] that a toe may be without contact, as when it touches down a little late
LEAST_HELD = 3.0  # [N] of planned pressure below which a toe before its lift is let go of
LEAST_PRESSED = 1.0  # [N] planned pressure that must be seen
_WINDOW = 3  # samples up to an instant over which its values are taken (median)


@dataclass(frozen=True)
class Slip:
    """A standing toe that slid."""

    limb: int
    time: float  # [s] when it was noticed
    instant: int
    distance: float  # [m] in all while it stood


@dataclass(frozen=True)
class LostContact:
    """A toe that should press and does not touch."""

    limb: int
    time: float  # [s] since when
    instant: int
    duration: float  # [s]


@dataclass(frozen=True)
class Comparison:
    """Simulated beside planned at the instants reached (K of the plan's)."""

    instant: IntArray  # (K,)
    sample: IntArray  # (K,) trajectory sample taken for each
    # (K, N) simulated torque of the planned worst motor's limb: largest of three; forces of joints
    # that slide count as torques at `RADIAN`
    torque: Array
    torque_planned: Array  # (K, N)
    friction: Array  # (K, N) simulated critical friction, 0 in the air
    friction_planned: Array  # (K, N)
    mu: Array  # (K, N) of the simulated terrain
    sag: Array  # (K, 3) planned com - simulated, once it is at rest [m]
    sag_predicted: Array  # (K, 3) by the nonlinear static equilibrium under the run's own load [m]
    lag: Array  # (K, 3) body at rest - body passing by: how far motors trail their commands [m]
    slips: tuple[Slip, ...]
    losses: tuple[LostContact, ...]

    @property
    def least_torque(self) -> float:
        """Planned torque from which on relative errors are told [N m]."""
        largest = float(self.torque_planned.max(initial=0.0))
        return min(LEAST_TORQUE, LEAST_TORQUE_SHARE * largest)

    @property
    def torque_error(self) -> Array:
        """Relative errors of the worst motor at every instant, over standing limbs together."""
        planned = self.torque_planned.max(axis=1)
        worst = self.torque_planned.argmax(axis=1)
        found = np.take_along_axis(self.torque, worst[:, None], axis=1)[:, 0]
        loaded = planned > self.least_torque
        return np.asarray(np.abs(found - planned)[loaded] / planned[loaded])

    @property
    def sag_error(self) -> Array:
        """|simulated - predicted| over |predicted| at instants that sag by over LEAST_SAG."""
        size = np.linalg.norm(self.sag_predicted, axis=1)
        off = np.linalg.norm(self.sag - self.sag_predicted, axis=1)
        return np.asarray(off[size > LEAST_SAG] / size[size > LEAST_SAG])


def compare(plan: ClimbPlan, run: Run) -> Comparison:
    """Hold a run against its plan at the instants it reached before a fall."""
    at, unit = instant_samples(plan), plan.robot.joint_unit
    reached = np.flatnonzero((at >= 0) & (at < run.samples - (20 if run.fallen else 0)))
    sample = at[reached]
    windows = np.maximum(sample[:, None] - np.arange(_WINDOW), 0)
    contact = plan.instants.contact[reached]
    torque = np.median(np.abs(run.torque[windows] * unit).max(axis=3), axis=1)
    normal = np.median(run.normal[windows], axis=1)
    shear = np.median(run.shear[windows], axis=1)
    critical = np.full(normal.shape, np.inf)
    np.divide(shear, normal, out=critical, where=normal > 0)
    critical[~contact] = 0.0
    return Comparison(
        instant=reached,
        sample=sample,
        torque=torque,
        torque_planned=np.abs(plan.forces.motor_torques[reached] * unit).max(axis=2),
        friction=critical,
        friction_planned=plan.forces.mu_critical[reached],
        mu=plan.instants.mu[reached] * run.conditions.friction,
        sag=plan.instants.com[reached] - run.rest_com[reached],
        sag_predicted=predicted_sag(plan, run.conditions, reached, run.rest_toes[reached]),
        lag=run.rest_com[reached] - run.com[sample],
        slips=find_slips(plan, run),
        losses=find_losses(plan, run),
    )


def predicted_sag(plan: ClimbPlan, conditions: Conditions, rows: IntArray, toes: Array) -> Array:
    """(K, 3) how far below its planned place the body is held by the commands [m].

    The nonlinear static equilibrium of joint springs, with the run's load and the places where the
    toes really stand. NaN where there is none.
    """
    instants, forces, robot = plan.instants, plan.forces, plan.robot
    load = instants.external_wrench[rows].copy()
    load[:, 2] -= robot.weight + conditions.payload * robot.gravity
    rotation = rotation_world_body(instants.rpy[rows])
    load[:, 3:] += links_moment(plan, conditions, rotation, instants.joint_angles[rows])
    axes = np.swapaxes(rotation, -1, -2)
    share = robot.structural_compliance_share
    moment = None
    if robot.gripper is not None and plan.grips is not None:
        arm = -robot.gripper.length * instants.normal[rows]
        moment = plan.grips.instants.moment[rows] + np.cross(arm, forces.force[rows])
    stiff = _with_stiffness(plan, motor_stiffness(robot, conditions) / (1 - share))
    normal = instants.normal[rows]
    braced = Braced(
        rolling(stiff, axes, instants.joint_angles[rows], normal),
        toes + foot_arm(robot, normal),
        instants.contact[rows],
        forces.joint_command[rows],
        instants.joint_angles[rows],
        load,
        moment,
        None if robot.sole is None else lying(robot.sole, normal),
    )
    with np.errstate(all="ignore"):  # toes that slid away may leave no equilibrium: NaN
        return np.asarray(-settle(braced, instants.com[rows], axes).shift)


def _with_stiffness(plan: ClimbPlan, stiffness: Array) -> Robot:
    return replace(plan.robot, joint_stiffness=stiffness)


def find_slips(plan: ClimbPlan, run: Run) -> tuple[Slip, ...]:
    """Toes that slid by more than SLIP while they should stand; spherical feet may roll.

    A toe that is let go of, planned to press by less than LEAST_HELD until it is lifted, may slide.
    Grippers hold or let go.
    """
    if run.grips is not None:
        return ()
    instant = sample_instants(plan)[: run.samples]
    contact = held_toes(plan)[: run.samples]
    found: list[Slip] = []
    for limb in range(plan.robot.limb_count):
        for first, last in spans_of(contact[:, limb]):
            touched = np.flatnonzero(run.touching[first:last, limb])
            if not len(touched):
                continue
            start = first + int(touched[0])
            shift = run.toes[start:last, limb] - run.toes[start, limb]
            if plan.robot.foot is not None and plan.robot.sole is None:
                normal = plan.instants.normal[max(int(instant[last - 1]), 0), limb]
                links = run.links[start:last, limb]
                shift = shift - rolled(plan.robot.foot.radius, links, normal)
            slid = np.linalg.norm(shift, axis=1)
            if slid.max(initial=0.0) > SLIP:
                when = start + int(np.argmax(slid > SLIP))
                found.append(
                    Slip(limb, float(run.time[when]), int(instant[when]), float(slid.max()))
                )
    return tuple(sorted(found, key=lambda s: s.time))


def held_toes(plan: ClimbPlan) -> BoolArray:
    """(T, N) toes on their surfaces but for those that are let go of."""
    contact = plan.trajectory.contact.copy()
    pressed = planned_pressure(plan) >= LEAST_HELD
    for limb in range(contact.shape[1]):
        for first, last in spans_of(contact[:, limb]):
            until = first + int(np.flatnonzero(pressed[first:last, limb]).max(initial=-1)) + 1
            # A toe that never presses is as good as one that stands: told if it slides.
            if first < until and last < len(contact):
                contact[until:last, limb] = False
    return contact


def find_losses(plan: ClimbPlan, run: Run) -> tuple[LostContact, ...]:
    """Toes without contact for more than LOST while the plan presses them.

    A push goes over into the next limb's lift, so that both instants must press.
    """
    instant = sample_instants(plan)[: run.samples]
    pressure = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    following = np.minimum(np.arange(len(pressure)) + 1, len(pressure) - 1)
    air = plan.instants.lifted.any(axis=1, keepdims=True)
    held = np.where(air, pressure, np.minimum(pressure, pressure[following]))
    pressed = np.where((instant >= 0)[:, None], held[np.maximum(instant, 0)], 0.0)
    stands = plan.trajectory.contact[: run.samples]
    if run.grips is not None:
        stands, pressed = gripped(plan)[: run.samples], np.full(stands.shape, np.inf)
    missing = np.asarray(stands & (pressed > LEAST_PRESSED) & ~run.touching, bool)
    found: list[LostContact] = []
    for limb in range(plan.robot.limb_count):
        for first, last in spans_of(missing[:, limb]):
            lasted = float(run.time[last - 1] - run.time[first])
            if lasted > LOST:
                found.append(LostContact(limb, float(run.time[first]), int(instant[first]), lasted))
    return tuple(sorted(found, key=lambda s: s.time))
