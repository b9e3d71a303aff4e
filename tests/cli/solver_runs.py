"""One command line for each method that can run longer than a second, to be stopped inside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SPECS = Path(__file__).parents[2] / "specs"


@dataclass(frozen=True)
class SolverRun:
    """A command line, without its output directory."""

    name: str
    words: tuple[str, ...]
    work: float  # [s] of processor time until which it is still inside, at least
    writes: bool = True  # a directory; else the work counts from the start of the process

    def arguments(self, given: Path) -> list[str]:
        """given: folder of the files that other commands made (`data`, `plan`)."""
        words = [w.replace("SPECS", str(SPECS)).replace("GIVEN", str(given)) for w in self.words]
        return [*words, "-o", "out"] if self.writes else words


def _run(name: str, words: str, work: float, writes: bool = True) -> SolverRun:
    return SolverRun(name, tuple(words.split()), work, writes)


_SHELF = "solve-bookshelf SPECS/bookshelf_file.yaml --time-limit 60 --method"
_STRATEGY = "fit-strategy SPECS/strategy_bookshelf.yaml --set data.files=[GIVEN/data/dataset.h5]"
_LIBRARY = "--set solver.library.file=GIVEN/data/dataset.h5"
_WALK = "plan-mpc SPECS/mpc_forward.yaml"
_FLAT = "plan-transition SPECS/transition_flat.yaml --method"
_OWN = "--problem SPECS/cart_pole.py:problem"
_POLE = f"solve SPECS/cart_pole.yaml {_OWN} --method"

RUNS = (
    _run("climb-micp", "plan-climb SPECS/climb_obstacle.yaml --method micp", 3.0),
    _run("climb-nlp", "plan-climb SPECS/climb_obstacle.yaml --method nlp", 3.0),
    _run("climb-auto", "plan-climb SPECS/climb_obstacle.yaml --set terrain.friction=0.3", 8.0),
    _run("climb-osqp", "plan-climb SPECS/climb_obstacle.yaml --solver osqp", 6.0),
    _run("climb-clarabel", "plan-climb SPECS/climb_obstacle.yaml --solver clarabel", 2.0),
    _run("climb-walker", "plan-climb SPECS/climb_walker.yaml", 3.0),
    _run("climb-grips", "plan-climb SPECS/climb_single_wall.yaml", 3.0),
    _run("climb-study", "plan-climb SPECS/climb_region.yaml", 8.0),
    _run("climb-study-2", "plan-climb SPECS/climb_region.yaml --jobs 2", 8.0),
    _run("climb-coupled", "plan-climb SPECS/climb_patches.yaml --method coupled", 6.0),
    _run("climb-coupled-modes", "plan-climb SPECS/climb_patches.yaml --method coupled-modes", 6.0),
    _run("climb-coupled-nlp", "plan-climb SPECS/climb_patches.yaml --method coupled-nlp", 6.0),
    _run(
        "climb-coupled-micp", "plan-climb SPECS/climb_patches.yaml --method coupled-mccormick", 5.0
    ),
    _run("climb-spatial", "plan-climb SPECS/climb_patches.yaml --method coupled-minlp-scip", 7.0),
    _run("transition", "plan-transition SPECS/transition_bricks.yaml --method stance-search", 4.0),
    _run("transition-complementarity", f"{_FLAT} mpcc", 2.0),
    _run("mission", "plan-transition SPECS/mission_ground_to_top.yaml", 4.0),
    _run("modules-modes", "plan-limms SPECS/limms_jump.yaml --method mode-search", 8.0),
    _run("modules-heavy", "plan-limms SPECS/limms_lift_heavy.yaml --method mode-search", 8.0),
    _run("modules-admm", "plan-limms SPECS/limms_throw.yaml --method admm", 4.0),
    _run("modules-admm-chain", "plan-limms SPECS/limms_double_arm.yaml --method admm", 9.0),
    _run("modules-masses", "plan-limms SPECS/limms_throw_with_mass.yaml", 8.0),
    _run("modules-admm-jump", "plan-limms SPECS/limms_jump.yaml --method admm", 8.0),
    _run("walk-search", "plan-mpc SPECS/mpc_turn.yaml --method gait-search", 6.0),
    _run("walk-nlp", "plan-mpc SPECS/mpc_turn.yaml --method mpcc", 3.0),
    _run(
        "walk-micp", f"{_WALK} --method spatial-branch-and-bound --set task.integrator=euler", 8.0
    ),
    _run("walk-online", "plan-mpc SPECS/mpc_recovery.yaml --method online", 8.0),
    _run("shelf-exact", f"{_SHELF} exact", 1.0),
    _run("shelf-convex", f"{_SHELF} pinned {_LIBRARY}", 4.0),
    _run("shelf-mpcc", f"{_SHELF} mpcc", 8.0),
    _run("shelf-scip", f"{_SHELF} minlp-scip", 8.0),
    _run("shelf-bonmin", f"{_SHELF} minlp-bonmin", 8.0),
    _run("shelf-micp", f"{_SHELF} mccormick", 8.0),
    _run("shelf-admm", f"{_SHELF} admm", 8.0),
    _run("shelf-knn", f"{_SHELF} knn {_LIBRARY}", 2.0),
    _run("pole-micp", f"{_POLE} mccormick", 8.0),
    _run("pole-scip", f"{_POLE} minlp-scip", 1.8),
    _run("pole-bonmin", f"{_POLE} minlp-bonmin", 1.6),
    _run("pole-mpcc", f"{_POLE} mpcc", 0.8),
    _run("pole-admm", f"{_POLE} admm", 4.0),
    _run("envelopes", "fit-envelopes SPECS/envelopes_wall3.yaml", 8.0),
    _run("data-shelf", "gen-data SPECS/dataset_bookshelf.yaml", 8.0),
    _run("data-walks", "gen-data SPECS/dataset_mpc.yaml --jobs 2", 8.0),
    _run("data-terrains", "gen-data SPECS/dataset_terrains_wall5.yaml", 8.0),
    _run("data-pole", f"gen-data SPECS/dataset_cart_pole.yaml {_OWN}", 8.0),
    _run("strategy-forest", f"{_STRATEGY} --method forest", 3.0),
    _run("strategy-boosting", f"{_STRATEGY} --method boosting", 3.0),
    _run("strategy-network", f"{_STRATEGY} --method network", 3.0),
    _run("strategy-reduce", f"{_STRATEGY} --method reduce", 3.0),
    _run("gripper", "fit-gripper SPECS/grips.csv", 2.0),
    _run("simulate", "simulate GIVEN/steps", 4.0),
    _run("report", "report GIVEN/steps", 3.0),
)
