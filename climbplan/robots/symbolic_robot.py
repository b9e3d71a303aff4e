"""The statement of a robot's limbs in programs, by its mechanism."""

from __future__ import annotations

from climbplan.errors import UsageError
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.symbolic_chains import SymbolicChains
from climbplan.robots.symbolic_closed_form import SymbolicClosedForm
from climbplan.robots.symbolic_limbs import SymbolicLimbs


def build_symbolic_limbs(robot: Robot) -> SymbolicLimbs:
    """Return the limbs of a robot as programs state them.

    Raises:
        UsageError: The legs are closed linkages.
    """
    if robot.mechanism is None:
        return SymbolicClosedForm(robot.limb_count)
    if isinstance(robot.mechanism, SerialChain):
        joints_of_capsules = None if robot.capsules is None else robot.capsules.joint.tolist()
        mounted = None if joints_of_capsules is None else tuple(map(tuple, joints_of_capsules))
        chain, count = robot.mechanism, robot.joint_count
        moving = chain.slide_zero is not None, chain.drive is not None
        kinds = *moving, robot.foot is not None, robot.links is not None
        return SymbolicChains(robot.limb_count, count, count > 3, mounted, *kinds)
    raise UsageError(
        f"{robot.name} has legs that are closed linkages, which smooth programs do not state; "
        "expected limbs of coxa, femur and tibia, or the legs of a URDF"
    )
