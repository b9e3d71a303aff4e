"""Simulate grippers: when they close and open, the loads on them, and when they fail.

A gripper that reaches its hold is welded to it and drawn to its planned place. Its wrist's motors
exert the planned torques, as under force control; in the air they orient it to the next hold.
Fingers grip with the planned force. A grip holds as long as its load can be distributed to palm and
fingers with each force in its cone, with the world's friction and spines and without safety factor.
Otherwise it fails, until the plan closes it again.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, spans_of
from climbplan.climb.forces.cones import ConicProgram
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.played import sample_instants
from climbplan.climb.simulation.grips.planned_grips import (
    compute_gripping_force,
    find_planned_regions,
    find_planned_toe,
    plan_wrists,
)
from climbplan.climb.simulation.model.gripper_model import (
    WRIST_STIFFNESS,
    name_weld,
    name_wrist_joint,
)
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.grip import GripCones, grip_cones, split_into_parts
from climbplan.simulation.conditions import Conditions
from climbplan.terrain.holds import flat_hold
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region


def compute_cone_excess(cones: GripCones, forces: Array) -> float:
    """Compute by how much forces (3, 3) on palm and fingers violate their cones [N]."""
    return float(max(cones.excess(forces, 1.0).max(), (-cones.pressure(forces)).max()))


def friction_to_slip(slipping: tuple[float, float]) -> float:
    """Return the friction coefficient at which a contact with a pressure and shear [N] slips."""
    return slipping[1] / max(slipping[0], 1e-9)


def distribute_grip_force(cones: GripCones, forces: Array) -> tuple[float, Array]:
    """Distribute a grip's load to palm and fingers with the smallest cone violation.

    A second-order cone program: minimise e >= 0 over the palm's force, subject to each force in its
    cone widened by e.

    Args:
        cones: Friction cones of palm and fingers.
        forces: (3, 3) on palm and fingers with a palm that carries nothing [N].

    Returns:
        The violation e [N], infinite without a solution, and the palm's force (3,) [N].
    """
    program = ConicProgram(4)  # the palm's force and e
    for index in range(3):
        coefficients = np.eye(3) if index == 0 else -np.eye(3) / 2
        axes = contact_frame(cones.normal[index]).axes
        rows, offsets = np.zeros((3, 4)), axes @ forces[index]
        rows[:, :3] = -axes @ coefficients
        mu = float(cones.mu)
        cone, end = rows.copy(), offsets.copy()
        cone[0], end[0] = mu * rows[0], mu * offsets[0] + cones.spines[index]
        cone[0, 3] = -1.0
        program.add_second_order_cone(f"cone.{index}", cone, end)
        pressure_rows = rows[:1].copy()
        pressure_rows[0, 3] = -1.0
        program.add_inequality(f"press.{index}", pressure_rows, offsets[:1])
    program.add_inequality("least", np.array([[0.0, 0.0, 0.0, -1.0]]), np.zeros(1))
    solution = program.minimise(np.array([0.0, 0.0, 0.0, 1.0]))
    if solution is None:
        return np.inf, np.zeros(3)
    return max(solution.value, 0.0), solution.x[:3]


MAX_MISS = 0.012  # [m] from its hold at which a gripper can still close
CLOSING_TIME = 0.3  # [s] in which fingers draw a gripper to its hold
_FILTER_TIME = 0.03  # [s] time constant of the load's filter
_SETTLING_TIME = 0.5  # [s] in which the robot comes to rest at the start
_FORCE_TOLERANCE = 1e-3  # of the robot's weight, that a grip may lack


@dataclass(frozen=True)
class GripFailure:
    """A grip that failed to close, or to hold."""

    limb: int
    time: float  # [s] of the plan
    instant: int  # -1 before the first
    message: str


@dataclass(frozen=True)
class GripReport:
    """The grips of a simulation."""

    misses: Array  # (G,) how far each gripper was from its hold when it closed [m]
    failures: tuple[GripFailure, ...]


class GripLoads(NamedTuple):
    """The loads on the grips of N limbs, zero if open."""

    force: Array  # (N, 3) on the grippers, world frame [N]
    normal: Array  # (N,) pressure of the part of each that is nearest to slipping [N]
    shear: Array  # (N,) its shear beyond what spines hold [N]
    closed: BoolArray  # (N,)


class _GripTarget(NamedTuple):
    """The hold that a gripper is to close on."""

    position: Array  # (3,) of the grip's centre [m]
    rotation: Array  # (3, 3) of a gripper that is square on it
    normal: Array  # (3,)
    cones: GripCones
    axis: Array  # (3,)


@dataclass
class _ClosedGrip:
    """A grip that is closed."""

    target: _GripTarget
    start_time: float  # [s] of the run
    start_position: Array  # (3,) where its gripper was then [m]
    start_quaternion: Array  # (4,)
    filtered_wrench: Array  # (6,) force [N] and moment about the grip's centre [N m], smoothed


class GripperSimulation:
    """The grippers of a model while it follows a trajectory."""

    def __init__(
        self,
        mujoco: ModuleType,
        model: Any,
        data: Any,
        plan: ClimbPlan,
        terrain: Terrain,
        conditions: Conditions,
    ) -> None:
        """Look up the model's welds, wrists and motors; terrain: as it is in the world."""
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.terrain, self.conditions = plan, terrain, conditions
        n = plan.robot.limb_count
        assert plan.robot.gripper is not None
        assert plan.grips is not None
        self.gripper, self.grips = plan.robot.gripper, plan.grips
        self.weld_ids = [model.equality(name_weld(limb)).id for limb in range(n)]
        self.body_ids = [model.body(f"gripper{limb}").id for limb in range(n)]
        names = [[name_wrist_joint(limb, j) for j in range(3)] for limb in range(n)]
        self.joint_addresses = np.array([[model.joint(x).qposadr[0] for x in row] for row in names])
        self.motor_ids = np.array([[model.actuator(x).id for x in row] for row in names])
        self.clock = 0.0  # [s] of the run
        self.closed_grips: dict[int, _ClosedGrip] = {}
        self.misses: list[float] = []
        self.failures: list[GripFailure] = []
        self._instant = sample_instants(plan)
        self._region = find_planned_regions(plan)
        self._wrists, self._torque = plan_wrists(plan, self._region)
        self._gripping = compute_gripping_force(plan, conditions.speed)
        self._holds = {int(r): self._build_target(int(r)) for r in np.unique(self._region)}
        self._weight = plan.robot.weight
        # Of a free body's constraint rows these columns are force and moment on the whole robot
        self._root = int(model.body_dofadr[model.body("body").id])
        self._body = model.body("body").id

    def close_initial(self) -> None:
        """Set wrists as planned, and close all grippers that start on their holds."""
        self.data.qpos[self.joint_addresses] = self._wrists[0]
        self.mujoco.mj_forward(self.model, self.data)
        for limb in np.flatnonzero(self.plan.trajectory.contact[0]):
            self._close_gripper(int(limb), 0, 0.0)

    def switch_grippers(self, sample: int, time: float) -> None:
        """Open and close what the plan opens and closes at a sample."""
        previous, following = self.plan.trajectory.contact[sample - 1 : sample + 1]
        for limb in np.flatnonzero(previous & ~following):
            if limb in self.closed_grips:
                self._open_gripper(int(limb))
        for limb in np.flatnonzero(following & ~previous):
            self._close_gripper(int(limb), sample, time)

    def command_wrists(self, sample: int, fraction: float = 1.0) -> None:
        """Command wrists at a fraction of the way to a sample."""
        previous, angles = max(sample - 1, 0), self.data.qpos[self.joint_addresses]
        target_angles = (1 - fraction) * self._wrists[previous] + fraction * self._wrists[sample]
        torque = (1 - fraction) * self._torque[previous] + fraction * self._torque[sample]
        is_closed = np.zeros(len(target_angles), bool)
        is_closed[list(self.closed_grips)] = True
        self.data.ctrl[self.motor_ids] = np.where(
            is_closed[:, None], angles + torque / WRIST_STIFFNESS, target_angles
        )

    def update_grips(self, sample: int, seconds: float, time: float) -> None:
        """Advance closing grips by a time [s], filter their loads, and open overloaded ones."""
        self.clock += seconds
        for limb, closed in list(self.closed_grips.items()):
            closing_fraction = min((self.clock - closed.start_time) / CLOSING_TIME, 1.0)
            weld = self.weld_ids[limb]
            position = (
                1 - closing_fraction
            ) * closed.start_position + closing_fraction * closed.target.position
            quat = np.empty(4)
            self.mujoco.mju_mat2Quat(quat, closed.target.rotation.ravel())
            quat = (
                quat * np.sign(quat @ closed.start_quaternion) * closing_fraction
                + (1 - closing_fraction) * closed.start_quaternion
            )
            self.model.eq_data[weld, 3:6] = position
            self.model.eq_data[weld, 6:10] = quat / np.linalg.norm(quat)
        filter_gain = min(seconds / _FILTER_TIME, 1.0)
        for limb, wrench in self._measure_wrenches().items():
            closed = self.closed_grips[limb]
            closed.filtered_wrench += filter_gain * (wrench - closed.filtered_wrench)
            if self.clock < _SETTLING_TIME:
                continue
            lacking_force = self._compute_lacking_force(limb, closed, sample)
            if lacking_force > _FORCE_TOLERANCE * self._weight:
                self._open_gripper(limb)
                message = (
                    f"slips off its hold: {lacking_force:.1f} N more than palm and fingers hold"
                )
                self.failures.append(GripFailure(limb, time, int(self._instant[sample]), message))

    def compute_loads(self, sample: int) -> GripLoads:
        """Compute the present loads on grips."""
        n = len(self.weld_ids)
        loads = GripLoads(np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n, bool))
        for limb, closed in self.closed_grips.items():
            loads.force[limb], loads.closed[limb] = closed.filtered_wrench[:3], True
            candidates = [
                self._find_slipping_part(closed, self._split_grip_force(limb, closed, sample, palm))
                for palm in self._list_palm_forces(limb, closed, sample)
            ]
            weakest = min(candidates, key=friction_to_slip)
            if friction_to_slip(weakest) > closed.target.cones.mu:
                palm_free = self._split_grip_force(limb, closed, sample, np.zeros(3))
                palm = distribute_grip_force(closed.target.cones, palm_free)[1]
                optimal = self._find_slipping_part(
                    closed, self._split_grip_force(limb, closed, sample, palm)
                )
                weakest = min(weakest, optimal, key=friction_to_slip)
            loads.normal[limb], loads.shear[limb] = weakest
        return loads

    @property
    def report(self) -> GripReport:
        """Distances and failures of all grips so far."""
        return GripReport(np.array(self.misses), tuple(self.failures))

    def _build_target(self, region: int) -> _GripTarget:
        surface = self.terrain.surfaces[region]
        assert isinstance(surface, Region)
        hold = surface.hold or flat_hold(surface.normal)
        axis = hold.axis - (hold.axis @ surface.normal) * surface.normal  # of a surface that turned
        axis = axis / np.linalg.norm(axis)
        cones = grip_cones(
            surface.normal,
            axis,
            np.array(hold.undercut),
            np.array(surface.friction * self.conditions.friction),
            np.array(self.grips.spines[region]),
        )
        # Columns: closing, across, against the approach
        rotation = np.stack([axis, np.cross(surface.normal, axis), surface.normal], axis=1)
        return _GripTarget(np.zeros(3), rotation, surface.normal, cones, axis)

    def _close_gripper(self, limb: int, sample: int, time: float) -> None:
        """Weld a gripper to its hold at its present place, if it is near enough."""
        data, link, region = self.data, self.body_ids[limb], int(self._region[sample, limb])
        grip_center = np.array([0.0, 0.0, -self.gripper.length])
        rotation = data.xmat[link].reshape(3, 3)
        place = data.xpos[link] + rotation @ grip_center
        hold = self._holds[region]
        surface = self.terrain.surfaces[region]
        assert isinstance(surface, Region)
        toe = find_planned_toe(self.plan, sample, limb)
        goal = surface.project(toe) - surface.standoff * surface.normal
        closing_axis = rotation[:, 0]
        if closing_axis @ hold.axis < 0:  # two fingers are the same after half a turn
            hold = hold._replace(rotation=hold.rotation * np.array([-1.0, -1.0, 1.0]))
        miss = float(np.linalg.norm(place - goal))
        self.misses.append(miss)
        if not miss <= MAX_MISS:
            message = f"misses its hold by {1e3 * miss:.0f} mm"
            self.failures.append(GripFailure(limb, time, int(self._instant[sample]), message))
            return
        weld = self.weld_ids[limb]
        self.model.eq_data[weld, :3] = grip_center
        self.model.eq_data[weld, 3:6] = place
        self.model.eq_data[weld, 6:10] = data.xquat[link]
        data.eq_active[weld] = 1
        self.closed_grips[limb] = _ClosedGrip(
            hold._replace(position=goal), self.clock, place, data.xquat[link].copy(), np.zeros(6)
        )

    def _open_gripper(self, limb: int) -> None:
        self.data.eq_active[self.weld_ids[limb]] = 0
        del self.closed_grips[limb]

    def _measure_wrenches(self) -> dict[int, Array]:
        """Force and moment (6,) on each closed gripper at its grip's centre, by its weld's rows."""
        data = self.data
        equality_type = int(self.mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        count = int(data.ne)
        ids = np.where(data.efc_type[:count] == equality_type, data.efc_id[:count], -1)
        jacobian = data.efc_J.reshape(-1, self.model.nv)
        body_rotation, origin = data.xmat[self._body].reshape(3, 3), data.xpos[self._body]
        wrenches = {}
        for limb, closed in self.closed_grips.items():
            rows = np.flatnonzero(ids == self.weld_ids[limb])
            if not len(rows):
                wrenches[limb] = np.zeros(6)
                continue
            generalised_force = jacobian[rows, self._root : self._root + 6].T @ data.efc_force[rows]
            # A free body's speeds: of its origin in the world, of its turning in its own frame
            body_moment = body_rotation @ generalised_force[3:]
            moment = body_moment - np.cross(closed.target.position - origin, generalised_force[:3])
            wrenches[limb] = np.concatenate([generalised_force[:3], moment])
        return wrenches

    def _list_palm_forces(self, limb: int, closed: _ClosedGrip, sample: int) -> Array:
        """List palm forces (P, 3) to try [N]: as planned, in proportion to the load, zero."""
        palm = self.grips.trajectory.palm[sample, limb]
        planned = self.grips.trajectory_force[sample, limb]
        size = float(planned @ planned)
        ratio = float(closed.filtered_wrench[:3] @ planned) / size if size > 0 else 0.0
        return np.stack([palm, max(ratio, 0.0) * palm, np.zeros(3)])

    def _split_grip_force(self, limb: int, closed: _ClosedGrip, sample: int, palm: Array) -> Array:
        """Split the load of a grip into forces (3, 3) on palm and fingers [N]."""
        wrench, grip = closed.filtered_wrench, self._gripping[sample, limb]
        span = self.gripper.finger_span
        axis = closed.target.axis
        return split_into_parts(wrench[:3], np.array(grip), wrench[3:], palm, axis, span)

    def _compute_lacking_force(self, limb: int, closed: _ClosedGrip, sample: int) -> float:
        """Compute the cone violation of a grip under the best distribution of its load [N]."""
        cones = closed.target.cones
        is_frictionless = any(
            loss.limb == limb and loss.start <= self._get_time(sample) < loss.start + loss.duration
            for loss in self.conditions.losses
        )
        if is_frictionless:
            no_spines = np.zeros_like(cones.spines)
            cones = GripCones(cones.normal, np.zeros_like(cones.mu), no_spines)
        for palm in self._list_palm_forces(limb, closed, sample):
            if (
                compute_cone_excess(cones, self._split_grip_force(limb, closed, sample, palm))
                <= 0.0
            ):
                return 0.0
        return distribute_grip_force(
            cones, self._split_grip_force(limb, closed, sample, np.zeros(3))
        )[0]

    def _find_slipping_part(self, closed: _ClosedGrip, forces: Array) -> tuple[float, float]:
        """Find the contact nearest to slipping: its pressure and its shear beyond spines [N]."""
        cones, min_shear = closed.target.cones, _FORCE_TOLERANCE * self._weight
        shear = np.maximum(cones.shear(forces) - cones.spines, 0.0)
        shear = np.where(shear > min_shear, shear, 0.0)
        pressure = cones.pressure(forces)
        worst = int(np.argmax(shear / np.maximum(pressure, 1e-9)))
        return float(pressure[worst]), float(shear[worst])

    def _get_time(self, sample: int) -> float:
        return float(self.plan.trajectory.time[sample])


def find_closed_grippers(plan: ClimbPlan) -> BoolArray:
    """Find grippers (T, N) that have been closed for at least CLOSING_TIME."""
    trajectory = plan.trajectory
    closed = trajectory.contact.copy()
    for limb in range(closed.shape[1]):
        for first, last in spans_of(trajectory.contact[:, limb]):
            if first:
                is_closing = trajectory.time[first:last] - trajectory.time[first] < CLOSING_TIME
                closed[first:last, limb] &= ~is_closing
    return closed
