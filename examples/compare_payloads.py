"""How much can the robot carry? The same climb with more and more on its back.

python examples/compare_payloads.py
"""

from __future__ import annotations

import climbplan
from climbplan.errors import NoPlanFound

SCENE = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-0.8, 1.0]},
    },
    "task": {"rounds": 1, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.1]}},
    "solver": {"method": "micp"},  # `auto` would also look for changes that help
}


def main() -> None:
    print("payload  least S_tau")
    for mass in (0.0, 2.0, 4.0, 8.0, 16.0, 32.0):  # [kg]
        try:
            plan = climbplan.plan(SCENE, {"task.payload.mass": mass})
        except NoPlanFound as refused:
            print(f"{mass:4.0f} kg  none: {refused.conflicts[0]}")
            continue
        print(f"{mass:4.0f} kg  {plan.instants.safety_torque.min():.2f}")


if __name__ == "__main__":
    main()
