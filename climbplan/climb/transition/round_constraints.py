"""Constraints and costs of one round that programs with fixed and free contact sequence share.

In a round the body waits at a pose while some limbs move, then it moves to the next pose. Before
the first round it may shift off its start (`posture.steps.com_shift_max`). Joint angles at each
point where a toe has to be in reach are functions of pose and toe, or variables with constraints
that tie them to these (`climbplan/robots/symbolic_limbs.py`). Forces are divided by the robot's
weight.

    transition.reach    a toe is in reach: |cos(knee)| within 1 (closed form), or the least
                        singular value of J off zero, as it is at full stretch (chains)
    kinematics.forward     forward kinematics meets the toe (chains)
    kinematics.settled  the nearest such angles to the posture (chains of more than 3 joints)
    transition.joints   joint angles within bounds there
    force.torque        |J^T f + links' gravity torque| <= s max_torque, s <= 1 / S_tau
    force.command       commanded angles (angles less deflection by forces) within joint bounds
    force.equilibrium   sum f = m g, sum r x f = c x m g (eqs. (4.15), (4.16)), with the centre of
                        mass of body and links at c from the body's origin
    steps.com           bounds on body steps
    steps.toe           bounds on toe steps

Bounds that depend on a robot or a spec are passed by block name when a program is solved.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.climb.transition.scene import TransitionScene
from climbplan.mechanics.stiffness import joint_softness
from climbplan.program.stage import Stage
from climbplan.program.staged_program import StagedProgram
from climbplan.robots.model import Robot
from climbplan.robots.symbolic_limbs import StandingLimbs, SymbolicLimbs
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.robots.symbols import build_rotation

_DOWN = (0.0, 0.0, -1.0)
COST_SCALE = 100.0  # costs of order one, as tolerances are absolute

# Blocks that tie limbs to their toes, each with rows for every limb and point
TIES = ("transition.reach", "kinematics.forward", "kinematics.settled", "transition.joints")

Shapes = Mapping[str, tuple[int, int]]


class RoundConstraints:
    """A stage between two poses, with its symbols by name; matrices have one column per limb."""

    def __init__(
        self, name: str, kinematics: SymbolicLimbs, variables: Shapes, parameters: Shapes
    ) -> None:
        """Create the symbols of a round.

        Args:
            name: Name of the stage.
            kinematics: Kinematics of the limbs.
            variables: Shapes of the variables of a round.
            parameters: Shapes of its parameters, in addition to those of the robot.

        Both contain the variables and parameters of `kinematics` at all points of a round, the
        columns of one point after those of another.
        """
        num_limbs = kinematics.limbs
        ends = {"toe_before": (3, num_limbs), "pose_after": (6, 1), "com_before": (3, 1)}
        self._kinematics = kinematics
        self._variables, self._parameters = (
            variables,
            {**_get_robot_shapes(kinematics), **parameters},
        )
        shapes = {**variables, **ends, **self._parameters}
        duplicates = (variables.keys() | ends.keys()) & self._parameters.keys()
        if duplicates:
            raise ValueError(
                f"{name}: {', '.join(sorted(duplicates))} named as variable and parameter"
            )
        self.symbols: dict[str, Any] = {n: ca.SX.sym(n, *shape) for n, shape in shapes.items()}
        self.stage = Stage(name, self.symbols)
        pose = self.symbols["pose"]
        self.rotation = build_rotation(pose[3:])
        self._com = ca.repmat(pose[:3], 1, num_limbs)
        # The first step counts from the start, even if the body has shifted off it
        self.position_step = self.symbols["pose_after"][:3] - self.symbols["com_before"]
        self.rotation_step = self.symbols["pose_after"][3:] - pose[3:]
        self.toe_step = self.symbols["toe"] - self.symbols["toe_before"]

    def build_limbs(self, points: Any, number: int) -> StandingLimbs:
        """Build limbs with toes at points (3, N), world frame; number: index of the point."""
        s, n = self.symbols, self._kinematics.limbs
        toes = self.rotation.T @ (points - self._com)
        limb_symbols = {
            name: s[name][:, number * n : (number + 1) * n]
            for name in (*self._kinematics.parameter_shapes, *self._kinematics.variable_shapes)
        }
        return self._kinematics.standing(s, toes, limb_symbols)

    def transform_to_world(self, points: Any) -> Any:
        """Transform points (3, N) from the body frame to the world."""
        return self._com + self.rotation @ points

    def add_reach(self, limbs: Sequence[StandingLimbs], margin: float) -> None:
        """Constrain toes to be in reach at all points, with a margin from full stretch."""
        for ties in zip(*(standing.ties(margin) for standing in limbs), strict=True):
            first = ties[0]
            rows = ca.vertcat(*(tie.rows for tie in ties))
            lower = -np.inf if first.lower is None else first.lower
            upper = np.inf if first.upper is None else first.upper
            self.stage.between(first.name, rows, lower, upper, first.unit)

    def compute_foot_moments(self, normals: Any, forces: Any) -> Any:
        """Compute moments (3, N) about toes of forces (3, N) at the contact points of feet.

        normals: (3, N) of the surfaces. Returns None for point toes.
        """
        if not self._kinematics.has_feet:
            return None
        radius = self.symbols["foot"]
        columns = range(forces.shape[1])
        return ca.horzcat(*(-radius * ca.cross(normals[:, i], forces[:, i]) for i in columns))

    def compute_torques(self, limbs: StandingLimbs, force: Any, moment: Any = None) -> Any:
        """Compute joint torques (J, N) of forces (3, N) on toes and moments, world frame."""
        moment_body = None if moment is None else self.rotation.T @ moment
        return limbs.torques(self.rotation.T @ force, moment_body)

    def add_torque_limits(self, limbs: StandingLimbs, torque: Any) -> None:
        """Constrain torques of contact forces and links' weight to a fraction s of the limits."""
        gravity_torque = limbs.weight_torques(self.rotation.T @ ca.DM(_DOWN))
        torque_use = (torque if gravity_torque is None else torque + gravity_torque) / self.symbols[
            "torque_limit"
        ]
        s = self.symbols["s"]
        self.stage.between("force.torque", ca.vertcat(torque_use - s, -torque_use - s), upper=0.0)

    def add_command_limits(self, limbs: StandingLimbs, torque: Any) -> None:
        """Constrain commanded angles: angles less joint deflection."""
        deflection = self.symbols["softness"] * torque
        self.stage.between("force.command", limbs.angles - deflection, unit="rad")

    def compute_commanded_depth(self, limbs: StandingLimbs, points: Any, torque: Any) -> Any:
        """Compute how deep (1, N) toes are commanded below points (3, N) of their surfaces [m]."""
        s = self.symbols
        free = limbs.free_toes(s["softness"] * torque)
        toes = self.rotation.T @ (points - self._com)
        return ca.sum1((self.rotation.T @ s["normal_old"]) * (toes - free))

    def add_equilibrium(self, limbs: StandingLimbs, force: Any, moment: Any = None) -> None:
        """Constrain forces (3, N) on the old toes, and moments, to balance robot and load, world.

        limbs: before the round; the weight of their links acts where they are.
        """
        load = self.symbols["load"]
        arm = self.symbols["toe_before"] - self._com
        moments = (ca.cross(arm[:, i], force[:, i]) for i in range(force.shape[1]))
        total_force = load[:3] + ca.DM(_DOWN) + ca.sum2(force)
        total_moment = sum(moments, load[3:])
        mass_center = limbs.centre()
        if mass_center is not None:
            total_moment += ca.cross(self.rotation @ mass_center, ca.DM(_DOWN))
        if moment is not None:
            total_moment += ca.sum2(moment)
        self.stage.equal("force.equilibrium", ca.vertcat(total_force, total_moment))

    def add_toe_steps(self) -> None:
        """Constrain squared toe steps."""
        self.stage.between("steps.toe", ca.sum1(self.toe_step**2), unit="m^2")

    def add_body_step(self) -> None:
        """Constrain the squared body step."""
        self.stage.between("steps.com", ca.sumsqr(self.position_step), unit="m^2")

    def add_costs(self, force_preference: float) -> None:
        """Add the costs of steps and effort; a small cost of forces makes them unique."""
        s, w = self.symbols, COST_SCALE * self.symbols["weights"]
        effort = s["s"] + force_preference * ca.sumsqr(s["force"])
        self.stage.minimise("steps.com", w[0] * ca.sumsqr(self.position_step))
        self.stage.minimise("steps.rotation", w[1] * ca.sumsqr(self.rotation_step))
        self.stage.minimise("steps.toe", w[2] * ca.sumsqr(self.toe_step))
        self.stage.minimise("effort", w[3] * effort)

    def build_trajectory(
        self, rounds: int, every_round: Iterable[str] = (), binaries: Iterable[str] = ()
    ) -> StagedProgram:
        """Build the trajectory of all rounds; start toes and goal pose are parameters.

        Args:
            rounds: Number of rounds.
            every_round: Parameters that differ by round, (d, rounds); others are (d, 1).
            binaries: Names of binary variables.
        """
        formulation = StagedProgram(self.stage.name)
        x: dict[str, list[Any]] = {name: [] for name in self._variables}
        for _ in range(rounds):
            for name, shape in self._variables.items():
                zero = np.zeros(shape[0] * shape[1])
                x[name].append(formulation.variable(name, zero, binary=name in binaries))
        first = formulation.parameter("first_toe", x["toe"][0].numel())
        start, last_pose = (
            formulation.parameter("first_com", 3),
            formulation.parameter("last_pose", 6),
        )
        p = {
            name: formulation.parameter(
                name, shape[0] * shape[1], rounds if name in every_round else 1
            )
            for name, shape in self._parameters.items()
        }
        formulation.add(
            self.stage,
            **{name: ca.horzcat(*columns) for name, columns in x.items()},
            toe_before=ca.horzcat(first, *x["toe"][:-1]),
            pose_after=ca.horzcat(*x["pose"][1:], last_pose),
            com_before=ca.horzcat(start, *(pose[:3] for pose in x["pose"][1:])),
            **p,
        )
        return formulation


def repeat_at_points(shapes: Shapes, points: int) -> dict[str, tuple[int, int]]:
    """Repeat the shapes of one point for as many points."""
    return {name: (rows, points * columns) for name, (rows, columns) in shapes.items()}


def _get_robot_shapes(kinematics: SymbolicLimbs) -> dict[str, tuple[int, int]]:
    by_joint = (kinematics.joints, kinematics.limbs)
    return {
        **kinematics.robot_parameter_shapes,
        "torque_limit": by_joint,  # over the weight [m]
        "softness": by_joint,  # times the weight [rad / m]
        "least_load": (1, 1),
        "weights": (4, 1),  # com, rotation, toe, effort
    }


def build_robot_parameters(scene: TransitionScene, first_toes: Array) -> dict[str, Array]:
    """Build the parameters that all programs of a scene share, as columns; first_toes: (N, 3)."""
    robot, weights = scene.robot, scene.spec.posture.weights
    parameters = {
        **{
            name: v.T.ravel()
            for name, v in build_symbolic_limbs(robot).compute_robot_parameters(robot).items()
        },
        "first_toe": first_toes.ravel(),
        "first_com": scene.start.com,
        "last_pose": np.concatenate([scene.goal.com, scene.goal.rpy]),
        "torque_limit": (robot.max_torque / robot.weight).ravel(),
        "softness": (joint_softness(robot) * robot.weight).ravel(),
        "least_load": np.array([scene.spec.search.min_load]),
        "weights": np.array([weights.com, weights.rotation, weights.toe, weights.effort]),
    }
    return convert_to_columns(parameters)


def convert_to_columns(parameters: Mapping[str, Array]) -> dict[str, Array]:
    """Convert parameters that are equal in all rounds to columns (d, 1)."""
    return {name: value.reshape(-1, 1) for name, value in parameters.items()}


def compute_first_pose_bounds(scene: TransitionScene) -> tuple[Array, Array]:
    """Compute bounds (6,) of the pose at the first lift: a square in the circle of shifts."""
    pose = np.concatenate([scene.start.com, scene.start.rpy])
    side = scene.spec.posture.steps.com_shift_max / np.sqrt(2)
    freedom = np.array([side, side, 0.0, 0.0, 0.0, 0.0])
    return pose - freedom, pose + freedom


def compute_joint_limits(robot: Robot, margin: float) -> tuple[Array, Array]:
    """Compute joint limits (N, J) with a margin [rad]; joints that a limb lacks stay at zero."""
    exists, scaled_margin = robot.has_joint, margin * robot.joint_unit
    return np.where(exists, robot.joint_lower + scaled_margin, 0.0), np.where(
        exists, robot.joint_upper - scaled_margin, 0.0
    )


def build_joint_row_bounds(robot: Robot, margin: float, points: int = 1) -> tuple[Array, Array]:
    """Build bounds of constraint rows (J points N) of angles, limb by limb, with a margin [rad]."""
    scaled_margin = margin * robot.joint_unit
    lower = np.repeat((robot.joint_lower + scaled_margin)[:, None], points, axis=1)
    upper = np.repeat((robot.joint_upper - scaled_margin)[:, None], points, axis=1)
    return lower.ravel(), upper.ravel()
