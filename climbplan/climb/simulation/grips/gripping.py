"""Grippers of a simulated robot: when they close and open, what they bear, and where they let go.

A gripper that reaches its hold is welded to it and drawn on to where the hold is. Its wrist's
motors bring the planned torques, as wrists do that hold them by force sensors; in the air they
point it to the next hold. Fingers grip with what is planned. A grip holds as long as palm and
fingers can share what it bears so that each stays within its cone, friction and spines as in this
world and without safety factor; where they cannot it lets go, until the plan closes it again.
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
    planned_gripping,
    planned_regions,
    planned_toe,
    planned_wrists,
)
from climbplan.climb.simulation.model.gripper_model import STIFF, weld_name, wrist_joint
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.grip import GripCones, grip_cones, parts_of
from climbplan.simulation.conditions import Conditions
from climbplan.terrain.holds import flat_hold
from climbplan.terrain.model import Terrain
from climbplan.terrain.surfaces import Region


def cone_excess(cones: GripCones, parts: Array) -> float:
    """By how much parts (3, 3) leave their cones [N]."""
    return float(max(cones.excess(parts, 1.0).max(), (-cones.pressure(parts)).max()))


def friction_to_slip(slipping: tuple[float, float]) -> float:
    """Friction coefficient at which a part of such pressure and shear slips."""
    return slipping[1] / max(slipping[0], 1e-9)


def shared_at_best(cones: GripCones, parts: Array) -> tuple[float, Array]:
    """Least e >= 0 such that parts are within cones wider by e [N], and the palm's force (3,) then.

    parts: (3, 3) forces on palm and fingers of a palm that takes nothing.
    """
    program = ConicProgram(4)  # the palm's force and e
    for part in range(3):
        share = np.eye(3) if part == 0 else -np.eye(3) / 2
        axes = contact_frame(cones.normal[part]).axes
        rows, ends = np.zeros((3, 4)), axes @ parts[part]
        rows[:, :3] = -axes @ share
        mu = float(cones.mu)
        cone, end = rows.copy(), ends.copy()
        cone[0], end[0] = mu * rows[0], mu * ends[0] + cones.spines[part]
        cone[0, 3] = -1.0
        program.cone(f"cone.{part}", cone, end)
        press = rows[:1].copy()
        press[0, 3] = -1.0
        program.below(f"press.{part}", press, ends[:1])
    program.below("least", np.array([[0.0, 0.0, 0.0, -1.0]]), np.zeros(1))
    answer = program.minimise(np.array([0.0, 0.0, 0.0, 1.0]))
    if answer is None:
        return np.inf, np.zeros(3)
    return max(answer.value, 0.0), answer.x[:3]


REACHED = 0.012  # [m] by which a gripper may miss its hold: more than that its fingers do not close
CLOSING = 0.3  # [s] in which fingers draw a gripper to its hold
_SMOOTH = 0.03  # [s] over which what a grip bears is felt
_STARTS = 0.5  # [s] in which a robot that is set up comes to rest, joints in their play
_MISSING = 1e-3  # of the robot's weight [N] that a grip may lack


@dataclass(frozen=True)
class LetGo:
    """A grip that did not come about, or did not last."""

    limb: int
    time: float  # [s] of the plan
    instant: int  # -1 before the first
    words: str


@dataclass(frozen=True)
class Gripped:
    """What became of the grips of a run."""

    missed: Array  # (G,) how far each gripper was from its hold when it closed [m]
    let_go: tuple[LetGo, ...]


class Borne(NamedTuple):
    """What grips of N limbs bear, zero of open ones."""

    force: Array  # (N, 3) on the grippers, world frame [N]
    normal: Array  # (N,) pressure of the part of each that is nearest to slipping [N]
    shear: Array  # (N,) its shear beyond what spines hold [N]
    closed: BoolArray  # (N,)


class _Hold(NamedTuple):
    """Where a gripper is to close."""

    place: Array  # (3,) of the grip's centre [m]
    turn: Array  # (3, 3) of a gripper that is square on it
    normal: Array  # (3,)
    cones: GripCones
    axis: Array  # (3,)


@dataclass
class _Closed:
    """A grip that is closed."""

    hold: _Hold
    since: float  # [s] of the run
    place: Array  # (3,) where its gripper was then [m]
    quat: Array  # (4,)
    felt: Array  # (6,) force [N] and moment about the grip's centre [N m], smoothed


class Grips:
    """All grippers of one model on their way through a trajectory."""

    def __init__(
        self,
        mujoco: ModuleType,
        model: Any,
        data: Any,
        plan: ClimbPlan,
        terrain: Terrain,
        conditions: Conditions,
    ) -> None:
        """terrain: as it is in the run's world."""
        self.mujoco, self.model, self.data = mujoco, model, data
        self.plan, self.terrain, self.conditions = plan, terrain, conditions
        n = plan.robot.limb_count
        assert plan.robot.gripper is not None
        assert plan.grips is not None
        self.gripper, self.grips = plan.robot.gripper, plan.grips
        self.number = [model.equality(weld_name(limb)).id for limb in range(n)]
        self.link = [model.body(f"gripper{limb}").id for limb in range(n)]
        names = [[wrist_joint(limb, j) for j in range(3)] for limb in range(n)]
        self.at = np.array([[model.joint(x).qposadr[0] for x in row] for row in names])
        self.motor = np.array([[model.actuator(x).id for x in row] for row in names])
        self.clock = 0.0  # [s] of the run
        self.closed: dict[int, _Closed] = {}
        self.misses: list[float] = []
        self.let_go: list[LetGo] = []
        self._instant = sample_instants(plan)
        self._region = planned_regions(plan)
        self._wrists, self._torque = planned_wrists(plan, self._region)
        self._gripping = planned_gripping(plan, conditions.speed)
        self._holds = {int(r): self._hold(int(r)) for r in np.unique(self._region)}
        self._weight = plan.robot.weight
        # Of a free body's constraint rows these columns are force and moment on the whole robot
        self._root = int(model.body_dofadr[model.body("body").id])
        self._body = model.body("body").id

    def start(self) -> None:
        """Wrists as planned, all grippers that the plan begins with closed on their holds."""
        self.data.qpos[self.at] = self._wrists[0]
        self.mujoco.mj_forward(self.model, self.data)
        for limb in np.flatnonzero(self.plan.trajectory.contact[0]):
            self._close(int(limb), 0, 0.0)

    def switch(self, sample: int, time: float) -> None:
        """Open and close what the plan opens and closes at a sample."""
        before, now = self.plan.trajectory.contact[sample - 1 : sample + 1]
        for limb in np.flatnonzero(before & ~now):
            if limb in self.closed:
                self._open(int(limb))
        for limb in np.flatnonzero(now & ~before):
            self._close(int(limb), sample, time)

    def command(self, sample: int, share: float = 1.0) -> None:
        """Tell wrists what to do on the way to a sample."""
        before, now = max(sample - 1, 0), self.data.qpos[self.at]
        aim = (1 - share) * self._wrists[before] + share * self._wrists[sample]
        torque = (1 - share) * self._torque[before] + share * self._torque[sample]
        held = np.zeros(len(aim), bool)
        held[list(self.closed)] = True
        self.data.ctrl[self.motor] = np.where(held[:, None], now + torque / STIFF, aim)

    def feel(self, sample: int, seconds: float, time: float) -> None:
        """Draw grippers on, and let go of what is too much, after so many seconds."""
        self.clock += seconds
        for limb, closed in list(self.closed.items()):
            part = min((self.clock - closed.since) / CLOSING, 1.0)
            number = self.number[limb]
            at = (1 - part) * closed.place + part * closed.hold.place
            quat = np.empty(4)
            self.mujoco.mju_mat2Quat(quat, closed.hold.turn.ravel())
            quat = quat * np.sign(quat @ closed.quat) * part + (1 - part) * closed.quat
            self.model.eq_data[number, 3:6] = at
            self.model.eq_data[number, 6:10] = quat / np.linalg.norm(quat)
        share = min(seconds / _SMOOTH, 1.0)
        for limb, wrench in self._wrenches().items():
            closed = self.closed[limb]
            closed.felt += share * (wrench - closed.felt)
            if self.clock < _STARTS:
                continue
            lacking = self._lacking(limb, closed, sample)
            if lacking > _MISSING * self._weight:
                self._open(limb)
                words = f"slips off its hold: {lacking:.1f} N more than palm and fingers hold"
                self.let_go.append(LetGo(limb, time, int(self._instant[sample]), words))

    def borne(self, sample: int) -> Borne:
        """What grips bear now."""
        n = len(self.number)
        out = Borne(np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n, bool))
        for limb, closed in self.closed.items():
            out.force[limb], out.closed[limb] = closed.felt[:3], True
            found = [
                self._slipping(closed, self._parts(limb, closed, sample, palm))
                for palm in self._palms(limb, closed, sample)
            ]
            best = min(found, key=friction_to_slip)
            if friction_to_slip(best) > closed.hold.cones.mu:
                bare = self._parts(limb, closed, sample, np.zeros(3))
                palm = shared_at_best(closed.hold.cones, bare)[1]
                exact = self._slipping(closed, self._parts(limb, closed, sample, palm))
                best = min(best, exact, key=friction_to_slip)
            out.normal[limb], out.shear[limb] = best
        return out

    @property
    def told(self) -> Gripped:
        """What became of all grips so far."""
        return Gripped(np.array(self.misses), tuple(self.let_go))

    def _hold(self, region: int) -> _Hold:
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
        turn = np.stack([axis, np.cross(surface.normal, axis), surface.normal], axis=1)
        return _Hold(np.zeros(3), turn, surface.normal, cones, axis)

    def _close(self, limb: int, sample: int, time: float) -> None:
        """Weld a gripper to its hold where it is now, if it has come near enough."""
        data, link, region = self.data, self.link[limb], int(self._region[sample, limb])
        own = np.array([0.0, 0.0, -self.gripper.length])
        turn = data.xmat[link].reshape(3, 3)
        place = data.xpos[link] + turn @ own
        hold = self._holds[region]
        surface = self.terrain.surfaces[region]
        assert isinstance(surface, Region)
        toe = planned_toe(self.plan, sample, limb)
        goal = surface.project(toe) - surface.standoff * surface.normal
        closing = turn[:, 0]
        if closing @ hold.axis < 0:  # two fingers are the same after half a turn
            hold = hold._replace(turn=hold.turn * np.array([-1.0, -1.0, 1.0]))
        missed = float(np.linalg.norm(place - goal))
        self.misses.append(missed)
        if not missed <= REACHED:
            words = f"misses its hold by {1e3 * missed:.0f} mm"
            self.let_go.append(LetGo(limb, time, int(self._instant[sample]), words))
            return
        number = self.number[limb]
        self.model.eq_data[number, :3] = own
        self.model.eq_data[number, 3:6] = place
        self.model.eq_data[number, 6:10] = data.xquat[link]
        data.eq_active[number] = 1
        self.closed[limb] = _Closed(
            hold._replace(place=goal), self.clock, place, data.xquat[link].copy(), np.zeros(6)
        )

    def _open(self, limb: int) -> None:
        self.data.eq_active[self.number[limb]] = 0
        del self.closed[limb]

    def _wrenches(self) -> dict[int, Array]:
        """Force and moment (6,) on each closed gripper at its grip's centre, by its weld's rows."""
        data = self.data
        kind = int(self.mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        count = int(data.ne)
        ids = np.where(data.efc_type[:count] == kind, data.efc_id[:count], -1)
        jacobian = data.efc_J.reshape(-1, self.model.nv)
        turn, origin = data.xmat[self._body].reshape(3, 3), data.xpos[self._body]
        out = {}
        for limb, closed in self.closed.items():
            rows = np.flatnonzero(ids == self.number[limb])
            if not len(rows):
                out[limb] = np.zeros(6)
                continue
            both = jacobian[rows, self._root : self._root + 6].T @ data.efc_force[rows]
            # A free body's speeds: of its origin in the world, of its turning in its own frame
            about = turn @ both[3:]
            moment = about - np.cross(closed.hold.place - origin, both[:3])
            out[limb] = np.concatenate([both[:3], moment])
        return out

    def _palms(self, limb: int, closed: _Closed, sample: int) -> Array:
        """(P, 3) what a palm may take of what a grip bears: as planned, in proportion, nothing."""
        palm = self.grips.trajectory.palm[sample, limb]
        planned = self.grips.trajectory_force[sample, limb]
        size = float(planned @ planned)
        ratio = float(closed.felt[:3] @ planned) / size if size > 0 else 0.0
        return np.stack([palm, max(ratio, 0.0) * palm, np.zeros(3)])

    def _parts(self, limb: int, closed: _Closed, sample: int, palm: Array) -> Array:
        """(3, 3) forces on palm and fingers."""
        felt, grip = closed.felt, self._gripping[sample, limb]
        span = self.gripper.finger_span
        axis = closed.hold.axis
        return parts_of(felt[:3], np.array(grip), felt[3:], palm, axis, span)

    def _lacking(self, limb: int, closed: _Closed, sample: int) -> float:
        """By how much palm and fingers cannot hold what a grip bears, shared at best [N]."""
        cones = closed.hold.cones
        slippery = any(
            loss.limb == limb and loss.start <= self._now(sample) < loss.start + loss.duration
            for loss in self.conditions.losses
        )
        if slippery:
            bare = np.zeros_like(cones.spines)
            cones = GripCones(cones.normal, np.zeros_like(cones.mu), bare)
        for palm in self._palms(limb, closed, sample):
            if cone_excess(cones, self._parts(limb, closed, sample, palm)) <= 0.0:
                return 0.0
        return shared_at_best(cones, self._parts(limb, closed, sample, np.zeros(3)))[0]

    def _slipping(self, closed: _Closed, parts: Array) -> tuple[float, float]:
        """Pressure of the part that is nearest to slipping, and its shear beyond its spines [N]."""
        cones, least = closed.hold.cones, _MISSING * self._weight
        shear = np.maximum(cones.shear(parts) - cones.spines, 0.0)
        shear = np.where(shear > least, shear, 0.0)
        press = cones.pressure(parts)
        worst = int(np.argmax(shear / np.maximum(press, 1e-9)))
        return float(press[worst]), float(shear[worst])

    def _now(self, sample: int) -> float:
        return float(self.plan.trajectory.time[sample])


def gripped(plan: ClimbPlan) -> BoolArray:
    """(T, N) grippers that have been closed on their holds for as long as closing takes."""
    moving = plan.trajectory
    out = moving.contact.copy()
    for limb in range(out.shape[1]):
        for first, last in spans_of(moving.contact[:, limb]):
            if first:
                late = moving.time[first:last] - moving.time[first] < CLOSING
                out[first:last, limb] &= ~late
    return out
