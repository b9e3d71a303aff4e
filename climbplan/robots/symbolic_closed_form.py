"""Limbs of coxa, femur and tibia in programs: angles as functions of the toe.

Knee branches are given. The formulas are those of `coxa_femur_tibia.py`. Rounding at full stretch
is cut off, so that they stay finite a little out of reach, where a row of the program says that the
toe is too far.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from climbplan.arrays import Array
from climbplan.robots.kinematics import solve_inverse_kinematics
from climbplan.robots.model import Robot
from climbplan.robots.symbolic_limbs import Shapes, Tie

_CUT = 1e-9  # of the cosine of the knee angle


@dataclass(frozen=True)
class ClosedFormAtToes:
    """N limbs with their toes at points."""

    shoulder: Any  # (3, N) [m]
    links: Any  # (3, N) [m]
    angles: Any  # (3, N) coxa, femur, tibia [rad], coxa not wrapped
    stretch: Any  # (1, N) cosine of the knee's angle: within -1 and 1 if the toe is in reach
    radial: Any  # (2, N) unit horizontal direction to the toe, body frame
    reach: Any  # (2, N) horizontal distance beyond the coxa and height of the toe [m]

    def ties(self, margin: float) -> list[Tie]:
        """Return the rows |cos(knee)| within 1, and joints within finite bounds."""
        return [
            Tie("transition.reach", self.stretch, "", margin - 1, 1 - margin),
            Tie("transition.joints", self.angles, "rad"),
        ]

    def centre(self) -> None:
        """Return None: limbs weigh nothing."""

    def weight_torques(self, down: Any) -> None:
        """Return None: limbs weigh nothing."""

    def free_toes(self, deflection: Any) -> Any:
        """Return toes (3, N) in free space, body frame, with joints back by `deflection` (3, N)."""
        links = self.links
        femur, tibia = self.angles[1, :] - deflection[1, :], self.angles[2, :] - deflection[2, :]
        u = links[1, :] * ca.cos(femur) + links[2, :] * ca.sin(femur + tibia)
        z = links[1, :] * ca.sin(femur) - links[2, :] * ca.cos(femur + tibia)
        out, turn = links[0, :] + u, -deflection[0, :]
        x = self.radial[0, :] * ca.cos(turn) - self.radial[1, :] * ca.sin(turn)
        y = self.radial[0, :] * ca.sin(turn) + self.radial[1, :] * ca.cos(turn)
        return self.shoulder + ca.vertcat(out * x, out * y, z)

    def torques(self, force: Any, moment: Any = None) -> Any:
        """Return joint torques J^T f (3, N) of forces (3, N) on the toes, body frame.

        Moments are not supported.
        """
        if moment is not None:
            raise TypeError("feet of finite size are stated for chains of joints")
        links = self.links
        outward = self.radial[0, :] * force[0, :] + self.radial[1, :] * force[1, :]
        sideways = self.radial[0, :] * force[1, :] - self.radial[1, :] * force[0, :]
        u, z = self.reach[0, :], self.reach[1, :]
        tilt = self.angles[1, :] + self.angles[2, :]
        return ca.vertcat(
            (u + links[0, :]) * sideways,
            -z * outward + u * force[2, :],
            links[2, :] * (ca.cos(tilt) * outward + ca.sin(tilt) * force[2, :]),
        )


@dataclass(frozen=True)
class SymbolicClosedForm:
    """N limbs of coxa, femur and tibia."""

    limbs: int

    @property
    def joints(self) -> int:
        """Coxa, femur and tibia."""
        return 3

    @property
    def has_feet(self) -> bool:
        """Toes are points."""
        return False

    @property
    def robot_parameter_shapes(self) -> Shapes:
        """First joints, link lengths, directions of the coxae, middles of their bounds."""
        n = self.limbs
        return {"shoulder": (3, n), "links": (3, n), "mount_yaw": (1, n), "middle": (1, n)}

    @property
    def parameter_shapes(self) -> Shapes:
        """Knee branches: -1 knee up, 1 knee down."""
        return {"branch": (1, self.limbs)}

    @property
    def variable_shapes(self) -> Shapes:
        """Nothing: angles are functions of the toes."""
        return {}

    def compute_robot_parameters(self, robot: Robot) -> dict[str, Array]:
        """Return the parameters of the robot."""
        return {
            "shoulder": robot.shoulder_body.T,
            "links": robot.link_lengths.T,
            "mount_yaw": robot.mount_yaw[None],
            "middle": (robot.joint_lower[:, 0] + robot.joint_upper[:, 0])[None] / 2,
        }

    def at_toes(self, robot: Robot, toes: Array) -> dict[str, Array]:
        """Return the knee branch in use for toes (..., N, 3); up where neither is."""
        within = solve_inverse_kinematics(robot, toes).within_bounds
        up, down = within[..., 0, :], within[..., 1, :]
        return {"branch": np.where(~up & down, 1.0, -1.0)[..., None]}

    def points(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[Any]:
        """Return shoulder, femur joint, knee and toe (3, N), body frame, for angles (3, N)."""
        shoulder, links = robot_parameters["shoulder"], robot_parameters["links"]
        psi, tilt = robot_parameters["mount_yaw"] + angles[0, :], angles[1, :] + angles[2, :]
        knee = links[0, :] + links[1, :] * ca.cos(angles[1, :]), links[1, :] * ca.sin(angles[1, :])
        toe = knee[0] + links[2, :] * ca.sin(tilt), knee[1] - links[2, :] * ca.cos(tilt)

        def point(radius: Any, height: Any) -> Any:
            return shoulder + ca.vertcat(radius * ca.cos(psi), radius * ca.sin(psi), height)

        level = ca.SX.zeros(1, self.limbs)
        return [shoulder, point(links[0, :], level), point(*knee), point(*toe)]

    def pieces(self, robot_parameters: Mapping[str, Any], angles: Any) -> list[tuple[Any, Any]]:
        """Return the links, straight from joint to joint and toe."""
        points = self.points(robot_parameters, angles)
        return list(itertools.pairwise(points))

    def standing(
        self, robot_parameters: Mapping[str, Any], toes: Any, values: Mapping[str, Any]
    ) -> ClosedFormAtToes:
        """Return limbs with toes (3, N) in the body frame, the coxa wrapped about its middle."""
        shoulder, links = robot_parameters["shoulder"], robot_parameters["links"]
        middle, branch = robot_parameters["middle"], values["branch"]
        offset = toes - shoulder
        distance = ca.sqrt(offset[0, :] ** 2 + offset[1, :] ** 2 + 1e-12)
        u, z = distance - links[0, :], offset[2, :]
        square = u**2 + z**2 - links[1, :] ** 2 - links[2, :] ** 2
        stretch = square / (2 * links[1, :] * links[2, :])
        inside = ca.fmax(ca.fmin(stretch, 1 - _CUT), -1 + _CUT)
        beta = branch * ca.acos(inside)
        knee = ca.atan2(links[2, :] * ca.sin(beta), links[1, :] + links[2, :] * ca.cos(beta))
        # The angle from the middle of the coxa's bounds, where atan2 has no jump.
        heading = robot_parameters["mount_yaw"] + middle
        along = offset[0, :] * ca.cos(heading) + offset[1, :] * ca.sin(heading)
        across = -offset[0, :] * ca.sin(heading) + offset[1, :] * ca.cos(heading)
        coxa = middle + ca.atan2(across, along)
        angles = ca.vertcat(coxa, ca.atan2(z, u) - knee, beta + ca.pi / 2)
        radial = ca.vertcat(offset[0, :] / distance, offset[1, :] / distance)
        return ClosedFormAtToes(shoulder, links, angles, stretch, radial, ca.vertcat(u, z))
