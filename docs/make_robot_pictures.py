"""Make the pictures of robots: a frame of a verified plan of each.

python docs/make_robot_pictures.py                 all of them, some fifteen minutes
python docs/make_robot_pictures.py silvia go2      some
python docs/make_robot_pictures.py --from outputs silvia    of plans that are there already

A shipped robot is shown in its scene, a public one as it steps on flat ground. Needs MuJoCo, EGL
or OSMesa, and the package of the public robots.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
sys.path.insert(0, str(Path(__file__).parents[1]))
from motion_pictures import draw_plan, write_card_picture
from robot_page import PACKAGE, SHIPPED, ShippedRobot, read_public_robots

import climbplan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.proposed.proposed import ProposalTrials
from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf
from climbplan.robots.urdf.proposal.propose_robot import propose_robot

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "robots"


def main() -> None:
    """Read the command line, make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="robots; all if left out")
    parser.add_argument("--from", dest="plans", type=Path, help="folder of plans by scene")
    given = parser.parse_args()
    PICTURES.mkdir(exist_ok=True)
    public = read_public_robots(ROOT / "docs" / "benchmarks" / "zoo.json")
    for robot in (*SHIPPED, *public):
        if given.names and robot.name not in given.names:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            if isinstance(robot, ShippedRobot):
                plan, fraction = find_plan(robot.scene, given.plans, Path(scratch)), robot.fraction
            else:
                plan, fraction = plan_steps(robot.part, Path(scratch)), 0.0
            target = PICTURES / f"{robot.name}.webp"
            write_card_picture(draw_plan(plan, fraction), target)
        print(f"{target.relative_to(ROOT)} {target.stat().st_size / 1000:.0f} kB", flush=True)


def find_plan(scene: str, plans: Path | None, scratch: Path) -> Path:
    """Return the plan of a shipped scene, of those there are or made now."""
    if plans is not None:
        return plans / scene / "plan.h5"
    return climbplan.plan(ROOT / "specs" / f"{scene}.yaml").save(scratch / "plan.h5")


def plan_steps(part: str, scratch: Path) -> Path:
    """Propose a robot of the package and plan its steps on flat ground; return the plan."""
    proposal = propose_robot(find_package_urdf(f"{PACKAGE}:{part}"))
    outcome = ProposalTrials(proposal, scratch).ground
    if outcome.plan is None:
        sys.exit(f"{part}: {outcome.why}")
    write_climb(outcome.plan, scratch / "plan.h5")
    return scratch / "plan.h5"


if __name__ == "__main__":
    main()
