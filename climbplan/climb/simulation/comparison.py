"""Compare a simulated run with its plan, at each instant: torques, friction, sag, slips."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.check.anew.feet import build_rolling_robot, compute_contact_arm
from climbplan.climb.check.anew.soles import compute_sole_axes
from climbplan.climb.check.anew.static_pose import BracedRobot, solve_equilibrium
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.control.feedforward import compute_links_moment
from climbplan.climb.simulation.control.planned_pressure import compute_planned_pressure
from climbplan.climb.simulation.grips.gripping import find_closed_grippers
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.mujoco_run import RecordedRun
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.measures import SLIP, integrate_rolling
from climbplan.simulation.motors import compute_motor_stiffness

# Planned torques below [N m], or below a share of the largest planned one, are left out of relative
# errors
MIN_TORQUE = 1.0
MIN_TORQUE_FRACTION = 0.2
MIN_SAG = 1e-3  # [m] smaller predicted sags are left out of relative errors
MIN_LOSS_DURATION = 0.5  # [s] without contact, to allow for late touchdowns
MIN_STANCE_PRESSURE = 3.0  # [N] planned pressure below which a toe before its lift may slide
MIN_DETECTED_PRESSURE = 1.0  # [N] planned pressure of which contact is expected
_WINDOW = 3  # samples up to an instant, whose median is compared


@dataclass(frozen=True)
class LimbSlip:
    """A standing toe that slid."""

    limb: int
    time: float  # [s] when it was noticed
    instant: int
    distance: float  # [m] in all while it stood


@dataclass(frozen=True)
class LimbLostContact:
    """A toe that should press and does not touch."""

    limb: int
    time: float  # [s] since when
    instant: int
    duration: float  # [s]


@dataclass(frozen=True)
class PlanComparison:
    """Simulated and planned values at the K instants of the plan that were reached."""

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
    slips: tuple[LimbSlip, ...]
    lost_contacts: tuple[LimbLostContact, ...]

    @property
    def min_torque(self) -> float:
        """Smallest planned torque with a relative error [N m]."""
        largest = float(self.torque_planned.max(initial=0.0))
        return min(MIN_TORQUE, MIN_TORQUE_FRACTION * largest)

    @property
    def torque_error(self) -> Array:
        """Relative errors of the worst motor at every instant, over standing limbs together."""
        planned = self.torque_planned.max(axis=1)
        worst = self.torque_planned.argmax(axis=1)
        simulated = np.take_along_axis(self.torque, worst[:, None], axis=1)[:, 0]
        loaded = planned > self.min_torque
        return np.asarray(np.abs(simulated - planned)[loaded] / planned[loaded])

    @property
    def sag_error(self) -> Array:
        """|simulated - predicted| over |predicted| at instants that sag by over LEAST_SAG."""
        size = np.linalg.norm(self.sag_predicted, axis=1)
        error = np.linalg.norm(self.sag - self.sag_predicted, axis=1)
        return np.asarray(error[size > MIN_SAG] / size[size > MIN_SAG])


def compare(plan: ClimbPlan, run: RecordedRun) -> PlanComparison:
    """Compare a run with its plan at the instants that it reached before a fall."""
    instant_samples, unit = find_instant_samples(plan), plan.robot.joint_unit
    reached = np.flatnonzero(
        (instant_samples >= 0) & (instant_samples < run.samples - (20 if run.fallen else 0))
    )
    sample = instant_samples[reached]
    windows = np.maximum(sample[:, None] - np.arange(_WINDOW), 0)
    contact = plan.instants.contact[reached]
    torque = np.median(np.abs(run.torque[windows] * unit).max(axis=3), axis=1)
    normal = np.median(run.normal[windows], axis=1)
    shear = np.median(run.shear[windows], axis=1)
    critical = np.full(normal.shape, np.inf)
    np.divide(shear, normal, out=critical, where=normal > 0)
    critical[~contact] = 0.0
    return PlanComparison(
        instant=reached,
        sample=sample,
        torque=torque,
        torque_planned=np.abs(plan.forces.motor_torques[reached] * unit).max(axis=2),
        friction=critical,
        friction_planned=plan.forces.mu_critical[reached],
        mu=plan.instants.mu[reached] * run.conditions.friction,
        sag=plan.instants.com[reached] - run.rest_com[reached],
        sag_predicted=predict_sag(plan, run.conditions, reached, run.rest_toes[reached]),
        lag=run.rest_com[reached] - run.com[sample],
        slips=find_slips(plan, run),
        lost_contacts=find_losses(plan, run),
    )


def predict_sag(plan: ClimbPlan, conditions: Conditions, rows: IntArray, toes: Array) -> Array:
    """Predict the sag (K, 3) of the body from its planned place [m], NaN without an equilibrium.

    It follows from the nonlinear static equilibrium of the joint springs under the run's load.

    Args:
        plan: The plan.
        conditions: Conditions of the run.
        rows: (K,) instants of the plan.
        toes: (K, N, 3) places where toes stand in the run [m].
    """
    instants, forces, robot = plan.instants, plan.forces, plan.robot
    load = instants.external_wrench[rows].copy()
    load[:, 2] -= robot.weight + conditions.payload * robot.gravity
    rotation = rotation_world_body(instants.rpy[rows])
    load[:, 3:] += compute_links_moment(plan, conditions, rotation, instants.joint_angles[rows])
    axes = np.swapaxes(rotation, -1, -2)
    structure_fraction = robot.structural_compliance_share
    moment = None
    if robot.gripper is not None and plan.grips is not None:
        arm = -robot.gripper.length * instants.normal[rows]
        moment = plan.grips.instants.moment[rows] + np.cross(arm, forces.force[rows])
    stiffened = _replace_stiffness(
        plan, compute_motor_stiffness(robot, conditions) / (1 - structure_fraction)
    )
    normal = instants.normal[rows]
    braced = BracedRobot(
        build_rolling_robot(stiffened, axes, instants.joint_angles[rows], normal),
        toes + compute_contact_arm(robot, normal),
        instants.contact[rows],
        forces.joint_command[rows],
        instants.joint_angles[rows],
        load,
        moment,
        None if robot.sole is None else compute_sole_axes(robot.sole, normal),
    )
    with np.errstate(all="ignore"):  # toes that slid away may leave no equilibrium: NaN
        return np.asarray(-solve_equilibrium(braced, instants.com[rows], axes).shift)


def _replace_stiffness(plan: ClimbPlan, stiffness: Array) -> Robot:
    return replace(plan.robot, joint_stiffness=stiffness)


@dataclass(frozen=True)
class StanceSlide:
    """How far a toe has slid since it touched, at each sample of a stance."""

    limb: int
    start: int  # sample at which it touched
    distance: Array  # (M,) [m]


def list_slides(plan: ClimbPlan, run: RecordedRun) -> Iterator[StanceSlide]:
    """Yield how far toes slide in each of their stances; rolling of spherical feet is no slide.

    A toe may slide at the end of its stance, where it is planned to press by less than
    MIN_STANCE_PRESSURE until it is lifted: that end is left out.
    """
    instant = sample_instants(plan)[: run.samples]
    contact = find_stance(plan)[: run.samples]
    for limb in range(plan.robot.limb_count):
        for first, last in spans_of(contact[:, limb]):
            contact_samples = np.flatnonzero(run.touching[first:last, limb])
            if not len(contact_samples):
                continue
            start = first + int(contact_samples[0])
            shift = run.toes[start:last, limb] - run.toes[start, limb]
            if plan.robot.foot is not None and plan.robot.sole is None:
                normal = plan.instants.normal[max(int(instant[last - 1]), 0), limb]
                links = run.links[start:last, limb]
                shift = shift - integrate_rolling(plan.robot.foot.radius, links, normal)
            yield StanceSlide(limb, start, np.linalg.norm(shift, axis=1))


def find_slips(plan: ClimbPlan, run: RecordedRun) -> tuple[LimbSlip, ...]:
    """Find toes that slid by more than SLIP in their stance. Grippers cannot slip."""
    if run.grips is not None:
        return ()
    instant = sample_instants(plan)
    slips: list[LimbSlip] = []
    for slide in list_slides(plan, run):
        farthest = float(slide.distance.max(initial=0.0))
        if farthest > SLIP:
            onset = slide.start + int(np.argmax(slide.distance > SLIP))
            slips.append(
                LimbSlip(slide.limb, float(run.time[onset]), int(instant[onset]), farthest)
            )
    return tuple(sorted(slips, key=lambda s: s.time))


def find_stance(plan: ClimbPlan) -> BoolArray:
    """Find toes (T, N) in stance: in contact, without the unloaded end before a lift."""
    contact = plan.trajectory.contact.copy()
    is_pressed = compute_planned_pressure(plan) >= MIN_STANCE_PRESSURE
    for limb in range(contact.shape[1]):
        for first, last in spans_of(contact[:, limb]):
            release = first + int(np.flatnonzero(is_pressed[first:last, limb]).max(initial=-1)) + 1
            # A toe that never presses counts as standing, so that its slips are reported.
            if first < release and last < len(contact):
                contact[release:last, limb] = False
    return contact


def find_losses(plan: ClimbPlan, run: RecordedRun) -> tuple[LimbLostContact, ...]:
    """Find toes without contact for more than MIN_LOSS_DURATION while they should press.

    A push ends in the lift of the next limb, so the plan must press at both instants.
    """
    instant = sample_instants(plan)[: run.samples]
    pressure = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    following = np.minimum(np.arange(len(pressure)) + 1, len(pressure) - 1)
    is_swing = plan.instants.lifted.any(axis=1, keepdims=True)
    min_pressure = np.where(is_swing, pressure, np.minimum(pressure, pressure[following]))
    pressed = np.where((instant >= 0)[:, None], min_pressure[np.maximum(instant, 0)], 0.0)
    is_standing = plan.trajectory.contact[: run.samples]
    if run.grips is not None:
        is_standing, pressed = (
            find_closed_grippers(plan)[: run.samples],
            np.full(is_standing.shape, np.inf),
        )
    missing = np.asarray(is_standing & (pressed > MIN_DETECTED_PRESSURE) & ~run.touching, bool)
    losses: list[LimbLostContact] = []
    for limb in range(plan.robot.limb_count):
        for first, last in spans_of(missing[:, limb]):
            duration = float(run.time[last - 1] - run.time[first])
            if duration > MIN_LOSS_DURATION:
                losses.append(
                    LimbLostContact(limb, float(run.time[first]), int(instant[first]), duration)
                )
    return tuple(sorted(losses, key=lambda s: s.time))
