"""Send an exported plan to a robot: a node of ROS 2 that follows `goal.yaml`.

Runs where ROS 2 is (rclpy, control_msgs, trajectory_msgs), not where climbplan is:

    climbplan export outputs/climb_steps --format jtc
    python3 follow_plan.py outputs/climb_steps/ros2_control/goal.yaml

The controller has to have the P gains of `controllers.yaml` beside it, or commands for its own
(`--gains`), or torques beside the angles (`--feedforward`). Put the robot into the plan's first
posture before: the controller goes from where it is straight to the first point. Ctrl-C cancels the
goal; the controller then holds the joints where they are.
"""

from __future__ import annotations

import sys

import rclpy
import yaml
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from trajectory_msgs.msg import JointTrajectoryPoint

ACTION = "/joint_trajectory_controller/follow_joint_trajectory"


def goal_of(path: str) -> FollowJointTrajectory.Goal:
    """The stored goal as a message."""
    with open(path, encoding="utf-8") as stream:
        # Compiled, as safe as `safe_load` and ten times as fast where PyYAML has it
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(stream)
        stored = loader.get_single_data()
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = stored["trajectory"]["joint_names"]
    for given in stored["trajectory"]["points"]:
        point = JointTrajectoryPoint()
        point.positions = given["positions"]
        point.velocities = given["velocities"]
        point.accelerations = given["accelerations"]
        point.effort = given.get("effort", [])
        point.time_from_start = Duration(**given["time_from_start"])
        goal.trajectory.points.append(point)
    return goal


def main() -> int:
    """0 where the controller reached the end of the plan, 130 where Ctrl-C cancelled it."""
    # Otherwise Ctrl-C ends the context, and nobody could tell the controller
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("follow_plan")
    client = ActionClient(node, FollowJointTrajectory, ACTION)
    client.wait_for_server()
    sent = client.send_goal_async(goal_of(sys.argv[1]))
    rclpy.spin_until_future_complete(node, sent)
    handle = sent.result()
    if handle is None or not handle.accepted:
        node.get_logger().error("the controller refused the goal")
        return 1
    result = handle.get_result_async()
    try:
        rclpy.spin_until_future_complete(node, result)
    except KeyboardInterrupt:
        rclpy.spin_until_future_complete(node, handle.cancel_goal_async())
        node.get_logger().warning("the goal is cancelled")
        return 130
    answer = result.result().result
    node.get_logger().info(f"ended with {answer.error_code} {answer.error_string}")
    return 0 if answer.error_code == FollowJointTrajectory.Result.SUCCESSFUL else 1


if __name__ == "__main__":
    sys.exit(main())
