"""A module latches to a wall, picks a box up and throws it: who does what, and when.

python examples/modules.py
"""

from __future__ import annotations

from pathlib import Path

import climbplan

SPEC = Path(__file__).parents[1] / "specs" / "limms_throw.yaml"


def main() -> None:
    plan = climbplan.plan(SPEC)
    print(*plan.summary, sep="\n")
    checked = plan.verify()
    print(checked.badge)
    print(*checked.leaves_out, sep="\n")
    begin, end = plan.box.position[0, 0], plan.box.position[-1, 0]  # of the first box, (3,) [m]
    print(f"{plan.time[-1]:.2f} s, box from {begin.round(3)} to {end.round(3)} m")


if __name__ == "__main__":
    main()
