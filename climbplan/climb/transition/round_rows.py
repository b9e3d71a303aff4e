"""Rows and costs of one round that hold whether its contact sequence is given or free, each once.

In a round the body waits at a pose while some limbs move, then it goes on to the next pose; before
the first round it may shift off its start (`posture.steps.shift_max`). Joint
angles at each point where a toe has to be in reach are functions of pose and toe, or variables with
rows that tie them to these (`climbplan/robots/stated_limbs.py`). Forces are in units of the robot's
weight.

    transition.reach    a toe is in reach: |cos(knee)| within 1 (closed form), or the least
                        singular value of J off zero, as it is at full stretch (chains)
    kinematics.toes     forward kinematics meets the toe (chains)
    kinematics.settled  the nearest such angles to the posture (chains of more than 3 joints)
    transition.joints   joint angles within bounds there
    force.torque        |J^T f| <= s max_torque, s <= 1 / S_tau, what links weigh added to J^T f
    force.command       angles less what forces bend them within joint bounds
    force.equilibrium   sum f = m g, sum r x f = c x m g (eqs. (4.15), (4.16)), links weighing where
                        they are, so that the centre of mass is at c from the body's origin
    steps.com           body steps within their bound
    steps.toe           toe steps likewise

Bounds that are numbers of a robot or a spec are given by block name when a program is solved.
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
from climbplan.program.trajectory import Trajectory
from climbplan.robots.model import Robot
from climbplan.robots.stated_limbs import StandingLimbs, StatedLimbs
from climbplan.robots.stated_robot import stated_limbs
from climbplan.robots.symbols import rotation

_DOWN = (0.0, 0.0, -1.0)
COST_SCALE = 100.0  # cost of about one, so that tolerances mean something

# Blocks of what ties limbs to their toes, each with rows for every limb and point
TIES = ("transition.reach", "kinematics.toes", "kinematics.settled", "transition.joints")

Shapes = Mapping[str, tuple[int, int]]


class RoundRows:
    """A stage between two poses, with its symbols by name; matrices have one column a limb."""

    def __init__(self, name: str, stated: StatedLimbs, variables: Shapes, numbers: Shapes) -> None:
        """variables, numbers: shapes of those of a round, numbers beside the robot's.

        Both have what is found and given of `stated` at as many points as `limbs` is asked for,
        one point's columns behind another's.
        """
        limbs = stated.limbs
        ends = {"toe_before": (3, limbs), "pose_after": (6, 1), "com_before": (3, 1)}
        self._stated = stated
        self._variables, self._numbers = variables, {**_robot_shapes(stated), **numbers}
        shapes = {**variables, **ends, **self._numbers}
        twice = (variables.keys() | ends.keys()) & self._numbers.keys()
        if twice:
            raise ValueError(f"{name}: {', '.join(sorted(twice))} named as variable and number")
        self.symbols: dict[str, Any] = {n: ca.SX.sym(n, *shape) for n, shape in shapes.items()}
        self.stage = Stage(name, self.symbols)
        pose = self.symbols["pose"]
        self.turn = rotation(pose[3:])
        self._com = ca.repmat(pose[:3], 1, limbs)
        # The first round's step counts from the start, which a shift may leave before any lift
        self.forward = self.symbols["pose_after"][:3] - self.symbols["com_before"]
        self.turning = self.symbols["pose_after"][3:] - pose[3:]
        self.step = self.symbols["toe"] - self.symbols["toe_before"]

    def limbs(self, points: Any, number: int) -> StandingLimbs:
        """Limbs with toes at points (3, N), world frame; number: of these points in the round."""
        s, n = self.symbols, self._stated.limbs
        toes = self.turn.T @ (points - self._com)
        own = {
            name: s[name][:, number * n : (number + 1) * n]
            for name in (*self._stated.given, *self._stated.found)
        }
        return self._stated.standing(s, toes, own)

    def world(self, points: Any) -> Any:
        """Points (3, N) of the body frame in the world."""
        return self._com + self.turn @ points

    def reach(self, limbs: Sequence[StandingLimbs], room: float) -> None:
        """Toes at one point of each limb after another in reach, `room` off full stretch."""
        for each in zip(*(standing.ties(room) for standing in limbs), strict=True):
            one = each[0]
            rows = ca.vertcat(*(tie.rows for tie in each))
            low = -np.inf if one.lower is None else one.lower
            high = np.inf if one.upper is None else one.upper
            self.stage.between(one.name, rows, low, high, one.unit)

    def foot_moments(self, normals: Any, forces: Any) -> Any:
        """Moments (3, N) about toes of forces (3, N) that act where feet of finite size touch.

        normals: (3, N) of the surfaces. None for point toes.
        """
        if not self._stated.footed:
            return None
        radius = self.symbols["foot"]
        columns = range(forces.shape[1])
        return ca.horzcat(*(-radius * ca.cross(normals[:, i], forces[:, i]) for i in columns))

    def torques(self, limbs: StandingLimbs, force: Any, moment: Any = None) -> Any:
        """Joint torques (J, N) of forces (3, N) on the toes and moments about them, world frame."""
        own = None if moment is None else self.turn.T @ moment
        return limbs.torques(self.turn.T @ force, own)

    def torque(self, limbs: StandingLimbs, torque: Any) -> None:
        """Of contact forces and of the links' own weight, within a share s of the limits."""
        own = limbs.weight_torques(self.turn.T @ ca.DM(_DOWN))
        use = (torque if own is None else torque + own) / self.symbols["torque_limit"]
        s = self.symbols["s"]
        self.stage.between("force.torque", ca.vertcat(use - s, -use - s), upper=0.0)

    def command(self, limbs: StandingLimbs, torque: Any) -> None:
        """Commanded angles, beyond which joints bend."""
        bent = self.symbols["softness"] * torque
        self.stage.between("force.command", limbs.angles - bent, unit="rad")

    def commanded_depth(self, limbs: StandingLimbs, points: Any, torque: Any) -> Any:
        """(1, N) how deep below points (3, N) on their surfaces toes are commanded [m], exactly."""
        s = self.symbols
        free = limbs.free_toes(s["softness"] * torque)
        toes = self.turn.T @ (points - self._com)
        return ca.sum1((self.turn.T @ s["normal_old"]) * (toes - free))

    def equilibrium(self, limbs: StandingLimbs, force: Any, moment: Any = None) -> None:
        """Forces (3, N) on the toes before the round, and moments, hold robot and load; world.

        limbs: as they are before the round; what they weigh acts where they are.
        """
        load = self.symbols["load"]
        arm = self.symbols["toe_before"] - self._com
        moments = (ca.cross(arm[:, i], force[:, i]) for i in range(force.shape[1]))
        total = load[:3] + ca.DM(_DOWN) + ca.sum2(force)
        turning = sum(moments, load[3:])
        centre = limbs.centre()
        if centre is not None:
            turning += ca.cross(self.turn @ centre, ca.DM(_DOWN))
        if moment is not None:
            turning += ca.sum2(moment)
        self.stage.equal("force.equilibrium", ca.vertcat(total, turning))

    def toe_steps(self) -> None:
        """Squared."""
        self.stage.between("steps.toe", ca.sum1(self.step**2), unit="m^2")

    def body_step(self) -> None:
        """Squared."""
        self.stage.between("steps.com", ca.sumsqr(self.forward), unit="m^2")

    def costs(self, force_preference: float) -> None:
        """Steps and effort; forces cost a little, which makes them unique."""
        s, w = self.symbols, COST_SCALE * self.symbols["weights"]
        effort = s["s"] + force_preference * ca.sumsqr(s["force"])
        self.stage.minimise("steps.com", w[0] * ca.sumsqr(self.forward))
        self.stage.minimise("steps.rotation", w[1] * ca.sumsqr(self.turning))
        self.stage.minimise("steps.toe", w[2] * ca.sumsqr(self.step))
        self.stage.minimise("effort", w[3] * effort)

    def trajectory(
        self, rounds: int, every_round: Iterable[str] = (), binaries: Iterable[str] = ()
    ) -> Trajectory:
        """The stage at all rounds; start toes and goal pose are numbers.

        every_round: numbers that are other ones each round, (d, rounds), the others (d, 1).
        """
        stated = Trajectory(self.stage.name)
        x: dict[str, list[Any]] = {name: [] for name in self._variables}
        for _ in range(rounds):
            for name, shape in self._variables.items():
                zero = np.zeros(shape[0] * shape[1])
                x[name].append(stated.variable(name, zero, binary=name in binaries))
        first = stated.parameter("first_toe", x["toe"][0].numel())
        start, last = stated.parameter("first_com", 3), stated.parameter("last_pose", 6)
        p = {
            name: stated.parameter(name, shape[0] * shape[1], rounds if name in every_round else 1)
            for name, shape in self._numbers.items()
        }
        stated.add(
            self.stage,
            **{name: ca.horzcat(*columns) for name, columns in x.items()},
            toe_before=ca.horzcat(first, *x["toe"][:-1]),
            pose_after=ca.horzcat(*x["pose"][1:], last),
            com_before=ca.horzcat(start, *(pose[:3] for pose in x["pose"][1:])),
            **p,
        )
        return stated


def at_points(shapes: Shapes, points: int) -> dict[str, tuple[int, int]]:
    """Shapes of what is given or found at one point, for as many points."""
    return {name: (rows, points * columns) for name, (rows, columns) in shapes.items()}


def _robot_shapes(stated: StatedLimbs) -> dict[str, tuple[int, int]]:
    by_joint = (stated.joints, stated.limbs)
    return {
        **stated.numbers,
        "torque_limit": by_joint,  # over the weight [m]
        "softness": by_joint,  # times the weight [rad / m]
        "least_load": (1, 1),
        "weights": (4, 1),  # com, rotation, toe, effort
    }


def robot_numbers(scene: TransitionScene, first_toes: Array) -> dict[str, Array]:
    """Numbers that all programs of a scene have, as columns; first_toes: (N, 3)."""
    robot, weights = scene.robot, scene.spec.posture.weights
    own = {
        **{name: v.T.ravel() for name, v in stated_limbs(robot).values(robot).items()},
        "first_toe": first_toes.ravel(),
        "first_com": scene.start.com,
        "last_pose": np.concatenate([scene.goal.com, scene.goal.rpy]),
        "torque_limit": (robot.max_torque / robot.weight).ravel(),
        "softness": (joint_softness(robot) * robot.weight).ravel(),
        "least_load": np.array([scene.spec.search.least_load]),
        "weights": np.array([weights.com, weights.rotation, weights.toe, weights.effort]),
    }
    return as_columns(own)


def as_columns(numbers: Mapping[str, Array]) -> dict[str, Array]:
    """Numbers that are the same in all rounds, (d, 1) each."""
    return {name: value.reshape(-1, 1) for name, value in numbers.items()}


def first_ends(scene: TransitionScene) -> tuple[Array, Array]:
    """Bounds (6,) of the pose at the first lift: a square within the circle of allowed shifts."""
    pose = np.concatenate([scene.start.com, scene.start.rpy])
    side = scene.spec.posture.steps.shift_max / np.sqrt(2)
    room = np.array([side, side, 0.0, 0.0, 0.0, 0.0])
    return pose - room, pose + room


def joint_ends(robot: Robot, room: float) -> tuple[Array, Array]:
    """Joint bounds (N, J) with room off them; joints that a limb does not have stay at zero."""
    has, kept = robot.has_joint, room * robot.joint_unit
    return np.where(has, robot.joint_lower + kept, 0.0), np.where(
        has, robot.joint_upper - kept, 0.0
    )


def joint_bounds(robot: Robot, room: float, points: int = 1) -> tuple[Array, Array]:
    """Of rows of (J points N) angles, limb by limb, with room off their bounds."""
    kept = room * robot.joint_unit
    lower = np.repeat((robot.joint_lower + kept)[:, None], points, axis=1)
    upper = np.repeat((robot.joint_upper - kept)[:, None], points, axis=1)
    return lower.ravel(), upper.ravel()
