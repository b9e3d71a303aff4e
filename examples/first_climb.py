"""Plan a short climb between two walls, check it, draw it, export it.

python examples/first_climb.py
"""

from __future__ import annotations

import climbplan

SCENE = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-0.8, 1.0]},
    },
    "task": {"rounds": 2, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.2]}},
}


def main() -> None:
    plan = climbplan.plan(SCENE)
    print(plan.verify().headline())
    print(plan.write_report("outputs/first_climb"))
    print(plan.save("outputs/first_climb", force=True))
    plan.to_csv("outputs/first_climb/trajectory.csv")


if __name__ == "__main__":
    main()
