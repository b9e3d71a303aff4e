"""Which robots `zoo` takes: those of a Python package, and a hexapod of our own."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from importlib.resources import as_file
from pathlib import Path

from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf
from climbplan.schema.examples import locate_example_resource

PACKAGE = "example-robot-data"


@dataclass(frozen=True)
class Zoo:
    """One robot: what the table calls it, and its URDF."""

    name: str
    part: str  # of its path in the package, or the name of a file beside the examples
    ours: bool = False

    def urdf(self, stack: ExitStack) -> Path:
        """Its URDF, there until the stack closes; raises UsageError without the package."""
        if self.ours:
            return stack.enter_context(as_file(locate_example_resource(self.part)))
        return find_package_urdf(f"{PACKAGE}:{self.part}")


ROBOTS = (
    Zoo("A1", "a1_description/urdf/a1"),
    Zoo("ANYmal B", "anymal_b_simple_description/robots/anymal"),
    Zoo("ANYmal C", "anymal_c_simple_description/urdf/anymal"),
    Zoo("B1", "b1_description/urdf/b1"),
    Zoo("Go1", "go1_description/urdf/go1"),
    Zoo("Go2", "go2_description/urdf/go2"),
    Zoo("HyQ", "hyq_no_sensors"),
    Zoo("Laikago", "laikago_description/urdf/laikago"),
    Zoo("Solo12", "robots/solo12"),
    Zoo("ANYmal-Kinova", "anymal-kinova"),
    Zoo("B1-Z1", "b1-z1"),
    Zoo("hexapod", "hexapod.urdf", ours=True),
    Zoo("Solo", "robots/solo"),
    Zoo("quadruped", "quadruped_description"),
    Zoo("Bolt", "robots/bolt"),
    Zoo("Alexander", "alexander_v1"),
    Zoo("Centauro", "centauro"),
    Zoo("G1", "g1_29dof_rev_1_0"),
    Zoo("iCub", "robots/icub"),
    Zoo("Talos", "talos_reduced"),
    Zoo("Romeo", "romeo_small"),
    Zoo("simple_humanoid", "simple_humanoid_description/urdf/simple_humanoid"),
)
QUICK = ("Solo12",)
