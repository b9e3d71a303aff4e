"""Climb with a regulator in the loop: a node of ROS 2 that plays an exported plan.

Runs where ROS 2 is (rclpy, sensor_msgs, std_msgs), not where climbplan is:

    climbplan export outputs/climb_steps --format regulator --gains 80
    python3 regulated_plan.py outputs/climb_steps/regulator

It listens to /joint_states and sends positions to a position controller of ros2_control, joint by
joint in the order of that controller's `joints`, which has to be the one of the plan. Put the robot
into the plan's first posture before. The P gains have to be those of the export.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

RATE = 100.0  # [Hz]
SILENT = 0.1  # [s] without joint states after which the plan waits
COMMANDS = "/position_controller/commands"


class RegulatedPlan(Node):
    """Reads joints, ticks the regulator, commands joints."""

    def __init__(self, directory: Path) -> None:
        super().__init__("regulated_plan")
        sys.path.insert(0, str(directory))
        from joint_regulator import JointRegulator, read_tables

        with np.load(directory / "regulator.npz") as stored:
            names = stored["joint_names"]
        self.there = names != ""
        self.index = {
            str(name): at
            for at, name in zip(np.argwhere(self.there), names[self.there], strict=True)
        }
        self.regulator = JointRegulator(read_tables(directory / "regulator.npz"))
        self.angles = np.zeros(names.shape)
        self.read: set[str] = set()
        self.heard = self.get_clock().now()
        self.time = 0.0
        self.sender = self.create_publisher(Float64MultiArray, COMMANDS, 1)
        self.create_subscription(JointState, "/joint_states", self.hear, 1)
        self.create_timer(1.0 / RATE, self.tick)

    def hear(self, message: JointState) -> None:
        """Keep what the encoders say."""
        for name, position in zip(message.name, message.position, strict=True):
            if name in self.index:
                self.angles[tuple(self.index[name])] = position
                self.read.add(name)
        self.heard = self.get_clock().now()

    def tick(self) -> None:
        """The next commands; the plan waits where joints are silent."""
        silent = (self.get_clock().now() - self.heard).nanoseconds * 1e-9
        if len(self.read) < len(self.index) or silent > SILENT:
            return
        command = self.regulator.tick(self.time, self.angles)
        self.sender.publish(Float64MultiArray(data=command[self.there].tolist()))
        self.time = min(self.time + 1.0 / RATE, self.regulator.end)


def main() -> None:
    """Play until interrupted; at the end of the plan its last posture is held."""
    rclpy.init()
    rclpy.spin(RegulatedPlan(Path(sys.argv[1])))


if __name__ == "__main__":
    main()
