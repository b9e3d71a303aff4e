"""Climb in closed loop: a node of ROS 2 that waits for each contact of a plan.

Runs where ROS 2 (rclpy, sensor_msgs, std_msgs) and climbplan are:

    python3 closed_loop_climb.py outputs/climb_steps/plan.h5

It listens to /joint_states, whose `effort` has the torques of the motors, and sends positions to a
position controller of ros2_control, joint by joint in the order of that controller's `joints`,
which has to be the one of the plan. Put the robot into the plan's first posture before. The P gains
have to be the joint stiffness of the robot file.

A robot that has stopped before its goal holds its last commands while the rest of the climb is
planned from where it stands, at most MAX_REPLANS times.
"""

from __future__ import annotations

import sys
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

import climbplan
from climbplan.errors import ClimbplanError

RATE = 100.0  # [Hz]
SILENT = 0.1  # [s] without joint states after which the robot waits
COMMANDS = "/position_controller/commands"
HOLDING_TIME = 5.0  # [s] after a stop until the robot is at rest and another plan is sought
MAX_REPLANS = 2


class ClosedLoopClimb(Node):
    """Reads joints, steps the executive, commands joints."""

    def __init__(self, plan_file: str) -> None:
        super().__init__("closed_loop_climb")
        self.executive = climbplan.load_plan(plan_file).executive()
        self.held = 0.0  # [s] since the robot has stopped
        self.replans = 0
        self.planner = ThreadPoolExecutor(1)
        self.planning: Future | None = None
        robot = self.executive.robot
        self.has_joint = robot.has_joint
        places = map(tuple, np.argwhere(self.has_joint))
        self.place = dict(zip(robot.motor_names, places, strict=True))
        self.angles, self.torques = np.zeros((2, *self.has_joint.shape))
        self.read: set[str] = set()
        self.heard = self.get_clock().now()
        self.sender = self.create_publisher(Float64MultiArray, COMMANDS, 1)
        self.create_subscription(JointState, "/joint_states", self.hear, 1)
        self.create_timer(1.0 / RATE, self.tick)

    def hear(self, message: JointState) -> None:
        """Keep what encoders and motors say; contacts cannot be measured without torques."""
        if len(message.effort) != len(message.name):
            self.get_logger().error(
                "/joint_states has no effort for each joint: expected motor torques [N m] there",
                once=True,
            )
            return
        for name, angle, torque in zip(message.name, message.position, message.effort, strict=True):
            if name in self.place:
                self.angles[self.place[name]], self.torques[self.place[name]] = angle, torque
                self.read.add(name)
        self.heard = self.get_clock().now()

    def tick(self) -> None:
        """Send the next commands; where joints are silent the last ones stay."""
        silent = (self.get_clock().now() - self.heard).nanoseconds * 1e-9
        if len(self.read) < len(self.place) or silent > SILENT:
            return
        if self.planning is not None:
            self.go_on(self.planning)
            return
        executive = self.executive
        was_running = not executive.finished
        executive.step(1.0 / RATE, self.angles, self.torques)
        self.sender.publish(
            Float64MultiArray(data=executive.motor_command[self.has_joint].tolist())
        )
        if was_running and executive.finished:
            self.get_logger().info(executive.stopped or "the climb has ended")
        if executive.stopped and self.replans < MAX_REPLANS:
            self.held += 1.0 / RATE
            if self.held >= HOLDING_TIME:
                self.planning = self.planner.submit(executive.replan)

    def go_on(self, planning: Future) -> None:
        """Go on by the plan from where the robot stands, once there is one."""
        if not planning.done():
            return
        self.planning, self.held = None, 0.0
        self.replans += 1
        try:
            self.executive = planning.result()
            self.get_logger().info("goes on by a plan from where it stands")
        except ClimbplanError as reason:
            self.replans = MAX_REPLANS
            self.get_logger().info(f"no plan from where it stands: {reason}")


def main() -> None:
    """Climb until interrupted; at its end, or where it stops, the robot holds itself."""
    rclpy.init()
    rclpy.spin(ClosedLoopClimb(sys.argv[1]))


if __name__ == "__main__":
    main()
