"""How fast a motion may be played: inverse dynamics with its contact forces solved again.

Played faster by a factor s, a motion passes the same postures, with velocities s times and
accelerations s^2 times as large. With sigma = s^2, its contact forces f have to satisfy

    u_0 + sigma u_1 + U f = 0            forces and moments on all links
    |t_0 + sigma t_1 + L f| <= t_max     torques of all joints
    |f_t| <= mu f_n, f_n >= 0            each contact, as an inscribed pyramid of eight sides

at every sample, where index 0 is the motion at rest and 1 what its velocities add. The forces
nearest to the planned ones are those of a quadratic program a sample. Joint speeds bound s from
above.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import daqp
import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.errors import UsageError
from climbplan.motions.inverse_dynamics import MotionDynamics, compute_dynamics
from climbplan.motions.link_tree import RobotFile
from climbplan.motions.measure import find_dynamics_obstacle
from climbplan.motions.tracked_motion import ContactSamples, TrackedMotion

MAX_PACE = 20.0  # beyond, nothing is tried
MIN_PACE = 0.1
_NUM_BISECTIONS = 10
_FACETS = 8
_FAR = 1e30  # no bound, in DAQP's terms
_EQUALITY = 5  # of DAQP
_OPTIMAL = 1
_FORCE_TOLERANCE = 1e-10  # of the weight


@dataclass(frozen=True)
class ForceProblem:
    """Balance and limits of a motion at S samples; forces in units of the weight."""

    static_load: Array  # (S, 6 + J) wrench and torques that forces balance at rest
    inertial_load: Array  # (S, 6 + J) what the velocities add at the motion's own pace
    force_map: Array  # (S, 6 + J, C, 3) wrench and torques that contact forces add
    torque_limit: Array  # (J,), or (S, J) [weights m]
    cones: Array  # (S, C, F + 1, 3) rows of friction pyramids, the last along the normal
    is_touching: BoolArray  # (S, C)
    weight: float  # [N]
    max_pace: float  # by joint speeds
    planned_force: Array | None = None  # (S, C, 3) that forces stay near to; None: zero
    cost: Array | None = None  # (S, C, 3, C, 3) Hessian of the difference; None: its squares

    def solve(self, sample: int, pace: float) -> Array | None:
        """Return contact forces (C, 3) [weights] at a sample; None if there are none."""
        touching = np.flatnonzero(self.is_touching[sample])
        count = 3 * len(touching)
        load = self.static_load[sample] + pace**2 * self.inertial_load[sample]
        limit = np.broadcast_to(self.torque_limit, self.static_load[:, 6:].shape)[sample]
        force = np.zeros((self.is_touching.shape[1], 3))
        if not count:
            is_free = np.abs(load[:6]).max() < 1e-6
            return force if is_free and (np.abs(load[6:]) <= limit).all() else None
        balance = self.force_map[sample][:, touching].reshape(len(load), count)
        rows = self.cones.shape[2]
        cone = np.zeros((len(touching) * rows, count))
        for k, contact in enumerate(touching):
            cone[k * rows : (k + 1) * rows, 3 * k : 3 * k + 3] = self.cones[sample, contact]
        upper = np.concatenate([-load[:6], limit - load[6:], np.zeros(len(cone))])
        lower = np.concatenate([-load[:6], -limit - load[6:], np.full(len(cone), -_FAR)])
        sense = np.zeros(len(upper), np.int32)
        sense[:6] = _EQUALITY
        hessian, gradient = self._build_cost(sample, touching)
        answer, _, flag, _ = daqp.solve(
            hessian,
            gradient,
            np.vstack([balance, cone]),
            upper,
            lower,
            sense,
            primal_tol=_FORCE_TOLERANCE,
        )
        solution = np.asarray(answer)
        if flag != _OPTIMAL or not np.isfinite(solution).all():
            return None
        force[touching] = solution.reshape(-1, 3)
        return force

    def _build_cost(self, sample: int, touching: IntArray) -> tuple[Array, Array]:
        """Return Hessian (3 K, 3 K) and gradient (3 K,) of the cost of K contacts at a sample."""
        count = 3 * len(touching)
        hessian = np.eye(count)
        if self.cost is not None:
            hessian = self.cost[sample][touching][:, :, touching].reshape(count, count)
        if self.planned_force is None:
            return hessian, np.zeros(count)
        return hessian, -hessian @ self.planned_force[sample, touching].ravel()

    def find_sample_pace(self, sample: int, max_pace: float) -> float:
        """Return the largest pace up to a maximum with forces at a sample; 0 if there is none."""
        if self.solve(sample, max_pace) is not None:
            return max_pace
        low, high = 0.0, max_pace
        for _ in range(_NUM_BISECTIONS):
            middle = (low + high) / 2
            low, high = (low, middle) if self.solve(sample, middle) is None else (middle, high)
        return low

    def find_infeasible_sample(self, pace: float, first: int = 0) -> int | None:
        """Return a sample without forces at a pace, beginning at `first`; None if there is none."""
        count = len(self.static_load)
        order = [*range(first, count), *range(first)]
        return next((k for k in order if self.solve(k, pace) is None), None)


def find_pace_obstacle(motion: TrackedMotion, robot: RobotFile) -> str:
    """Return why no forces can be solved for a motion; "" if they can."""
    if reason := find_dynamics_obstacle(motion, robot):
        return reason
    if motion.bounds is None or motion.surfaces is None:
        return "no limits of joints or no friction in the file"
    if motion.contacts is not None and motion.contacts.moment is not None:
        return "flat feet carry moments, which are not solved for"
    return ""


def build_force_problem(motion: TrackedMotion, robot: RobotFile) -> ForceProblem:
    """Return balance and limits of a motion of a robot.

    Args:
        motion: A motion with contacts, contact forces, friction and limits of joints.
        robot: Its file.

    Raises:
        UsageError: The motion lacks something that inverse dynamics needs.
    """
    if reason := find_pace_obstacle(motion, robot):
        raise UsageError(f"{motion.name}: no pace: {reason}")
    contacts, bounds, surfaces = motion.contacts, motion.bounds, motion.surfaces
    assert contacts is not None
    assert bounds is not None
    assert surfaces is not None
    forceless = replace(motion, contacts=_replace_force(contacts, None))
    still = replace(
        forceless,
        body_velocity=np.zeros_like(motion.body_velocity),
        body_angular_velocity=np.zeros_like(motion.body_angular_velocity),
    )
    at_rest = compute_dynamics(still, robot.urdf, robot.links)
    weight = at_rest.weight
    static_load = _stack(at_rest)
    inertial_load = _stack(compute_dynamics(forceless, robot.urdf, robot.links)) - static_load
    force_map = np.zeros((*static_load.shape, len(contacts.names), 3))
    for contact in range(len(contacts.names)):
        for axis in range(3):
            probe = replace(still, contacts=_replace_force(contacts, (contact, axis)))
            unit = compute_dynamics(probe, robot.urdf, robot.links)
            force_map[:, :, contact, axis] = _stack(unit) - static_load
    columns = [motion.joint_names.index(name) for name in robot.links.joint_names]
    planned_force = np.zeros((*contacts.position[1:-1].shape,))
    if contacts.force is not None:
        planned_force = contacts.force[1:-1]
    speed = np.abs(motion.joint_velocity).max(axis=0)
    ratio = bounds.speed / np.maximum(speed, 1e-12)
    return ForceProblem(
        static_load=static_load / weight,
        inertial_load=inertial_load / weight,
        force_map=force_map,
        torque_limit=np.minimum(bounds.torque[columns] / weight, _FAR),
        cones=build_pyramids(
            contacts.normal[1:-1],
            surfaces.friction[np.maximum(contacts.surface[1:-1], 0)],
            planned_force,
        ),
        is_touching=contacts.is_touching[1:-1],
        weight=weight,
        max_pace=float(min(MAX_PACE, ratio.min())),
        planned_force=planned_force / weight,
    )


def find_fastest_pace(problem: ForceProblem) -> float:
    """Return the largest factor at which forces exist at every sample; 0 if there is none.

    It is found by bisection, to 1 %: samples have forces for an interval of factors that begins at
    rest, because the conditions are linear in forces and the factor's square.
    """
    sample = problem.find_infeasible_sample(problem.max_pace)
    if sample is None:
        return problem.max_pace
    low, high = MIN_PACE, problem.max_pace
    if problem.find_infeasible_sample(low, sample) is not None:
        return 0.0
    for _ in range(_NUM_BISECTIONS):
        middle = float(np.sqrt(low * high))
        failing = problem.find_infeasible_sample(middle, sample)
        if failing is None:
            low = middle
        else:
            high, sample = middle, failing
    return low


def retime_motion(
    motion: TrackedMotion, problem: ForceProblem, pace: float
) -> TrackedMotion | None:
    """Return a motion played faster by a factor, with its own forces and torques.

    Args:
        motion: The motion at its own pace.
        problem: Its balance and limits.
        pace: The factor.

    Returns:
        The motion, whose rate is higher by the factor; None if a joint is too slow for it, or a
        sample has no forces.
    """
    if pace > problem.max_pace:
        return None
    count = len(problem.static_load)
    force = np.zeros((count, *problem.force_map.shape[2:]))
    for sample in range(count):
        solution = problem.solve(sample, pace)
        if solution is None:
            return None
        force[sample] = solution
    load = problem.static_load + pace**2 * problem.inertial_load
    load += np.einsum("tica,tca->ti", problem.force_map, force)
    assert motion.contacts is not None
    contact_force = _repeat_ends(force) * problem.weight
    return replace(
        motion,
        fps=motion.fps * pace,
        joint_velocity=motion.joint_velocity * pace,
        body_velocity=motion.body_velocity * pace,
        body_angular_velocity=motion.body_angular_velocity * pace,
        joint_command=None,
        joint_torque=_repeat_ends(load[:, 6:]) * problem.weight,
        contacts=replace(motion.contacts, force=contact_force),
    )


def _stack(dynamics: MotionDynamics) -> Array:
    """Return wrench and torques (T - 2, 6 + J)."""
    loads = (dynamics.unbalanced_force, dynamics.unbalanced_moment, dynamics.torque)
    return np.concatenate(loads, axis=1)


def _replace_force(contacts: ContactSamples, unit: tuple[int, int] | None) -> ContactSamples:
    """Return contacts with a unit force of one contact along one axis, or without forces."""
    force = np.zeros(contacts.position.shape)
    if unit is not None:
        force[:, unit[0], unit[1]] = 1.0
    return replace(contacts, force=force)


def build_pyramids(
    normal: Array, friction: Array, force: Array, safety_factor: float = 1.0
) -> Array:
    """Return the rows (..., F + 1, 3) of inscribed friction pyramids: rows times f <= 0.

    An edge of each pyramid lies below its tangential force, which is inside where it keeps to
    friction.

    Args:
        normal: (..., 3) unit, into free space; zero in the air.
        friction: (...) coefficients.
        force: (..., 3) planned forces [N].
        safety_factor: By which friction is reduced, but not below what planned forces need.
    """
    pressure = (force * normal).sum(axis=-1, keepdims=True)
    tangential = force - pressure * normal
    size = np.linalg.norm(tangential, axis=-1, keepdims=True)
    helper = np.where(np.abs(normal[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.where(size > 1e-9, tangential, np.cross(normal, helper))
    first = first / np.maximum(np.linalg.norm(first, axis=-1, keepdims=True), 1e-12)
    second = np.cross(normal, first)
    required = (1 + _FORCE_TOLERANCE) * size / np.maximum(pressure, 1e-12)
    mu = np.clip(required, friction[..., None] / safety_factor, friction[..., None])
    mu = mu * np.cos(np.pi / _FACETS)
    angle = 2 * np.pi * (np.arange(_FACETS) + 0.5) / _FACETS
    sides = [np.cos(a) * first + np.sin(a) * second - mu * normal for a in angle]
    return np.stack([*sides, -normal], axis=-2)


def _repeat_ends(values: Array) -> Array:
    """Return values (T, ...) of all samples for those of inner ones."""
    return np.concatenate([values[:1], values, values[-1:]])
