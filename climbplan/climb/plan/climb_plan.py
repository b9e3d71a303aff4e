"""A climb or transition plan in memory, field by field as in its file.

Shapes: N limbs, M rounds, K instants, T samples, R surfaces. World frame, z up; SI units.
Forces act on the robot, from the terrain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.plan.grips import GripForces, GripPlan
from climbplan.climb.plan.promise import Promise
from climbplan.climb.plan.world_sample import WorldSample
from climbplan.robots.model import Robot
from climbplan.robots.visual_geometry import VisualGeometry
from climbplan.schema.robots.stored import RobotTexts
from climbplan.store.root_attributes import PlanHeader
from climbplan.terrain.model import Terrain


@dataclass(frozen=True)
class Rounds:
    """Postures: row 0 is the start, row j the end of round j."""

    com: Array  # (M+1, 3) body origin [m]
    rpy: Array  # (M+1, 3) roll, pitch, yaw [rad]
    toes: Array  # (M+1, N, 3) [m]
    region: IntArray  # (M+1, N) surface each toe stands on

    @property
    def count(self) -> int:
        """M."""
        return len(self.com) - 1

    def first(self, count: int) -> Rounds:
        """Return the start and so many rounds after it."""
        return Rounds(**{name: value[: count + 1] for name, value in vars(self).items()})


@dataclass(frozen=True)
class Instants:
    """The instants at which forces are planned: after each lift and each push.

    A climb has 2 N a round, one limb after the other; a transition lifts several limbs at once.
    """

    round: IntArray  # (K,) 1..M
    lifted: BoolArray  # (K, N) the limbs in the air
    contact: BoolArray  # (K, N) limbs that carry load
    com: Array  # (K, 3) planned body origin [m]
    rpy: Array  # (K, 3) [rad]
    toes: Array  # (K, N, 3) [m]; a lifted toe hovers above where it stood
    normal: Array  # (K, N, 3) unit, from the surface into free space
    mu: Array  # (K, N) friction coefficient
    region: IntArray  # (K, N) surface of each toe (a lifted toe: the one it left)
    joint_angles: Array  # (K, N, J) [rad]
    external_wrench: Array  # (K, 6) force and moment about the body origin beside the weight

    @property
    def count(self) -> int:
        """K."""
        return len(self.round)

    def label(self, k: int, limb_names: tuple[str, ...]) -> str:
        """Return where instant k stands in the gait: "round 3, LM lifted" or "round 3, push 2"."""
        round_label = f"round {self.round[k]}"
        if self.lifted[k].any():
            lifted = " ".join(limb_names[i] for i in np.flatnonzero(self.lifted[k]))
            return f"{round_label}, {lifted} lifted"
        in_round = self.round == self.round[k]
        if in_round.sum() <= 2:
            return f"{round_label}, push"
        return f"{round_label}, push {(int(in_round[: k + 1].sum()) + 1) // 2}"


@dataclass(frozen=True)
class InstantForces:
    """Contact forces at the instants and what follows from them."""

    force: Array  # (K, N, 3) [N], zero for lifted limbs
    joint_torques: Array  # (K, N, J) J^T force [N m]
    wall_deflection: Array  # (K, N, 3) imposed toe deflection [m]
    com_deflection: Array  # (K, 6) sag and small rotation of the body [m, rad]
    joint_command: Array  # (K, N, J) angles sent to the joints, which press with the forces [rad]
    toe_command: Array  # (K, N, 3) where the joint commands would put the toes in free space [m]
    safety_torque: Array  # (K,) least max_torque / |torque|
    safety_friction: Array  # (K,) least mu / mu_critical of the limbs in contact
    mu_critical: Array  # (K, N) friction coefficient at which the limb would slip, 0 if lifted
    grips: GripForces | None = None  # of robots with grippers
    link_torques: Array | None = None  # (K, N, J) of the links' own weight beside J^T force [N m]
    corner_force: Array | None = None  # (K, N, 4, 3) at corners of soles, of flat feet [N]
    # (K,) share of the spec's margins that the planner kept; not in files, where checks tell it
    margin_share: Array | None = None
    notes: tuple[str, ...] = ()  # which margins could not be kept whole, and what would help

    @property
    def motor_torques(self) -> Array:
        """(K, N, J) what motors hold: contact forces and the links' own weight [N m]."""
        if self.link_torques is None:
            return self.joint_torques
        return self.joint_torques + self.link_torques


@dataclass(frozen=True)
class Trajectory:
    """Playable motion at a fixed rate."""

    time: Array  # (T,) [s]
    com: Array  # (T, 3) [m]
    rpy: Array  # (T, 3) [rad]
    joint_command: Array  # (T, N, J) [rad]
    contact: BoolArray  # (T, N)
    grips: GripForces | None = None  # of robots with grippers
    force: Array | None = None  # (T, N, 3) contact forces, of grippers or of paced motions [N]
    moment: Array | None = None  # (T, N, 3) on flat feet about their toes, of paced motions [N m]
    torque: Array | None = None  # (T, N, J) of paced motions: contacts, links' weight and inertia

    @property
    def is_paced(self) -> bool:
        """Return whether the dynamics of the links time it; otherwise it is quasi-static."""
        return self.torque is not None


@dataclass(frozen=True)
class StepLimits:
    """Bounds the postures were planned with, kept for verification."""

    com_max: float  # [m]
    toe_max: float  # [m]
    rotation_max: float  # [rad] about each axis
    com_min: float  # [m]
    toe_min: float  # [m]
    goal_com: Array  # (3,) [m]
    goal_toes: Array  # (N, 3) [m]
    goal_tolerance: float  # [m]
    goal_rpy: Array  # (3,) [rad]
    goal_rotation_tolerance: float  # [rad] about each axis
    body_clearance: float  # [m]
    safety_friction: float  # S_mu asked for
    safety_torque: float  # least S_tau asked for
    shift_max: float = 0.0  # [m] that the body may be off its straight way where a limb is lifted


@dataclass(frozen=True)
class Study:
    """Labels over a grid of spec values."""

    keys: tuple[str, ...]  # one or two dotted keys
    values: tuple[Array, ...]  # values of each key
    label: IntArray  # (len(values[0]), len(values[1]) or 1): index into `LABELS`
    detail: tuple[str, ...]  # message of each cell, row by row

    LABELS = ("feasible", "force-infeasible", "kinematics-infeasible")


@dataclass(frozen=True)
class Sequences:
    """All contact sequences that a search found for a transition, the chosen one marked."""

    name: tuple[str, ...]  # (Q,) "3-3: RF RM LR | RR LM LF"
    cost: Array  # (Q,) of its best way through the poses searched
    safety_torque: Array  # (Q,) the largest S_tau it allows, at the friction asked for
    safety_friction: Array  # (Q,) the largest S_mu it allows, at the torque asked for
    outcome: tuple[str, ...]  # (Q,) what became of it: "chosen", "planned", or why it was refused


@dataclass(frozen=True, kw_only=True)
class ClimbPlan(PlanHeader):
    """Everything a climb or transition plan file holds."""

    robot: Robot
    terrain: Terrain
    rounds: Rounds
    instants: Instants
    forces: InstantForces
    trajectory: Trajectory
    limits: StepLimits
    status: str  # "optimal" or "feasible"
    objective: float
    bound: float | None
    gap: float | None
    study: Study | None = None
    kind: str = "climb"  # or "transition"
    sequences: Sequences | None = None
    grips: GripPlan | None = None
    robot_texts: RobotTexts = field(default_factory=RobotTexts)  # of files the robot is from
    looks: VisualGeometry | None = None  # of a robot from a URDF; only pictures read it
    promise: Promise | None = None  # of falls, where the spec states a risk
    sample: WorldSample | None = None  # of worlds, where it or the robot states an uncertainty

    @property
    def contact_sequence(self) -> str:
        """Return which limbs move together, round by round: "3-3: RF RM LR | RR LM LF".

        Rounds of a climb that follows, in which limbs move one after the other, are counted only.
        """
        lifted, names = self.instants.lifted[::2], self.robot.limb_names
        steps = np.bincount(self.instants.round[::2], minlength=self.rounds.count + 1)
        together = steps[self.instants.round[::2]] == 1
        if not together.any():
            return format_sequence(lifted, names)
        text = format_sequence(lifted[together], names)
        climbed = int((steps > 1).sum())
        return f"{text}; then {climbed} rounds limb by limb" if climbed else text


def format_sequence(step_limbs: BoolArray, limb_names: tuple[str, ...]) -> str:
    """Return the name of a contact sequence, moved: (S, N) limbs of each step."""
    counts = "-".join(str(int(step.sum())) for step in step_limbs)
    limbs = [" ".join(limb_names[i] for i in np.flatnonzero(step)) for step in step_limbs]
    return f"{counts}: {' | '.join(limbs)}"
