"""`climbplan bench`: comparison tables, each figure as a ratio measured in the same run."""

from __future__ import annotations

from typing import Annotated

import typer

from climbplan.cli.console import Session, print_result, standard_output
from climbplan.cli.options import Quiet, Verbose
from climbplan.errors import UsageError

BENCHMARKS = {
    "posture": "posture planner against SCIP on the same statement",
    "force": "force planner against CVXPY and Clarabel on the same instants",
    "plan": "the whole decoupled plan: postures, joint angles, forces, checks",
    "transition": "complementarity from random starts against the search over stance sets",
    "growth": "cost over rounds 2 to 32 and limbs 4 to 8",
}


def bench(
    context: typer.Context,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="One benchmark [default: all].")
    ] = None,
    show_list: Annotated[bool, typer.Option("--list", help="List the benchmarks.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Smaller instances, fewer runs.")] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed.")] = 0,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Compare the planners with named alternatives on the same instances."""
    if show_list:
        for known, meaning in BENCHMARKS.items():
            print_result(f"{known:<9} {meaning}")
        return
    if name is not None and name not in BENCHMARKS:
        raise UsageError(f"no benchmark {name!r}, known are {', '.join(BENCHMARKS)}")
    from climbplan.climb.benchmarks.run import run
    from climbplan.transition.benchmark import run_transition

    session = context.ensure_object(Session)
    for chosen in [name] if name is not None else BENCHMARKS:
        session.note(f"bench {chosen}: {BENCHMARKS[chosen]}")
        with standard_output() as stream:
            if chosen == "transition":
                run_transition(seed, quick, stream)
            else:
                run(chosen, seed, quick, stream)
