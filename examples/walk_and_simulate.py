"""A quadruped walks up three steps; then MuJoCo says how the plan fares.

    python examples/walk_and_simulate.py

Needs the extra `simulate`. A machine's first run compiles for half a minute.
"""

from __future__ import annotations

from pathlib import Path

import climbplan

SPEC = Path(__file__).parents[1] / "specs" / "mpc_stairs.yaml"


def main() -> None:
    plan = climbplan.plan(SPEC)
    print(plan, f"objective {plan.objective:.1f}")
    print(plan.contact.astype(int))  # (knots, legs): who stands when
    replayed = plan.simulate()
    print(replayed)
    print("stands" if replayed.passed else f"falls after {replayed.fall_time} s")


if __name__ == "__main__":
    main()
