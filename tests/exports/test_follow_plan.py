"""The node of ROS 2 that sends a goal: what it sends, and that Ctrl-C cancels it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
GOAL = """
trajectory:
  joint_names: [hip, knee]
  points:
  - {positions: [0.1, 0.2], velocities: [0.0, 0.0], accelerations: [0.0, 0.0],
     time_from_start: {sec: 1, nanosec: 5}}
"""


class Future:
    """An answer that is there as soon as a node spins for it."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def result(self) -> object:
        return self.answer


class Goal(SimpleNamespace):
    """A goal of FollowJointTrajectory."""

    def __init__(self) -> None:
        super().__init__(trajectory=SimpleNamespace(joint_names=[], points=[]))


class StubController:
    """A controller that accepts goals, and the node that speaks with it."""

    def __init__(self) -> None:
        self.sent: list[Goal] = []
        self.cancelled = 0
        self.running = Future(
            SimpleNamespace(result=SimpleNamespace(error_code=0, error_string=""))
        )
        self.interrupts = False

    def send_goal_async(self, goal: Goal) -> Future:
        self.sent.append(goal)
        return Future(
            SimpleNamespace(
                accepted=True,
                get_result_async=lambda: self.running,
                cancel_goal_async=self.cancel,
            )
        )

    def cancel(self) -> Future:
        self.cancelled += 1
        return Future(None)

    def wait_for_server(self) -> None:
        pass

    def spin(self, node: object, future: Future) -> None:
        if self.interrupts and future is self.running:
            raise KeyboardInterrupt


@pytest.fixture
def follow(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[StubController], int]:
    """Run the node on a stub of ROS 2."""
    (tmp_path / "goal.yaml").write_text(GOAL)
    monkeypatch.setattr(sys, "argv", ["follow_plan", str(tmp_path / "goal.yaml")])
    monkeypatch.syspath_prepend(ROOT / "examples" / "ros2")

    def run(controller: StubController) -> int:
        log = SimpleNamespace(info=print, warning=print, error=print)
        action = SimpleNamespace(Goal=Goal, Result=SimpleNamespace(SUCCESSFUL=0))
        stubs: dict[str, dict[str, Any]] = {
            "rclpy": {
                "init": lambda **options: None,
                "create_node": lambda name: SimpleNamespace(get_logger=lambda: log),
                "spin_until_future_complete": controller.spin,
            },
            "rclpy.action": {"ActionClient": lambda *given: controller},
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
            "builtin_interfaces.msg": {"Duration": SimpleNamespace},
            "control_msgs.action": {"FollowJointTrajectory": action},
            "trajectory_msgs.msg": {"JointTrajectoryPoint": SimpleNamespace},
        }
        for name, members in stubs.items():
            module = ModuleType(name)
            vars(module).update(members)
            monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.delitem(sys.modules, "follow_plan", raising=False)
        from follow_plan import main

        return int(main())

    return run


def test_the_goal_is_sent_as_it_is_stored(follow: Callable[[StubController], int]) -> None:
    controller = StubController()
    assert follow(controller) == 0
    (goal,) = controller.sent
    assert goal.trajectory.joint_names == ["hip", "knee"]
    assert goal.trajectory.points[0].positions == [0.1, 0.2]
    assert goal.trajectory.points[0].time_from_start == SimpleNamespace(sec=1, nanosec=5)
    assert controller.cancelled == 0


def test_ctrl_c_cancels_the_goal(follow: Callable[[StubController], int]) -> None:
    controller = StubController()
    controller.interrupts = True
    assert follow(controller) == 130
    assert controller.cancelled == 1
