"""The mixed-integer relaxation on the shipped tasks: its finds and bounds, beside the search."""

from __future__ import annotations

import time
from typing import TextIO

from climbplan.bench.walking.shipped_tasks import FORMS, TASKS, shipped
from climbplan.walking.micp.method import limits_of, solve_micp
from climbplan.walking.offline.nlp import solve_nlp
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.problem import build_task

_SECONDS, _QUICK = 150.0, 6.0
_LONGEST = 60.0


def bound_table(seed: int, quick: bool, stream: TextIO) -> None:
    """Print `micp` from the NLP's answer beside `search`, and its gap from the search's answer."""
    seconds = _QUICK if quick else _SECONDS
    print(
        f"micp: {seconds:.0f} s from the answer of nlp, and from that of search; bounds are of "
        "motions within the tube\n"
        "task               nlp    micp  bound    gap | search  CPU [s]  to micp | bound    gap",
        file=stream,
    )
    for name in TASKS[:1] if quick else TASKS:
        loaded = shipped(name, *FORMS["published"])  # `micp` knows no other
        task = build_task(loaded.spec, loaded.robot, loaded.source)
        known = solve_nlp(task, "trot", _LONGEST)
        begin = time.process_time()
        found = search(task, SearchLimits(_LONGEST, seed=seed, qps=loaded.spec.solver.qps))
        searched = time.process_time() - begin
        solver = loaded.spec.solver.model_copy(update={"time_limit": seconds})
        improved, proved = (
            solve_micp(task, limits_of(solver.model_copy(update={"warm": warm})), start)
            for warm, start in (("nlp", known), ("search", found))
        )
        print(
            f"{name:<16} {known.objective:6.1f}  {improved.objective:6.1f}  {improved.bound:5.1f}  "
            f"{_gap(improved.objective, improved.bound):4.0f} % | {found.objective:6.1f}  "
            f"{searched:7.2f}  {found.objective / improved.objective:7.3f} | {proved.bound:5.1f}  "
            f"{_gap(proved.objective, proved.bound):4.0f} %",
            file=stream,
            flush=True,
        )


def _gap(cost: float, bound: float | None) -> float:
    return 100.0 if bound is None else 100.0 * (cost - bound) / cost
