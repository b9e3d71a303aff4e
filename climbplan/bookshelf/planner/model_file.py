"""The mathematical program of a scene, written to a file that other solvers read."""

from __future__ import annotations

from pathlib import Path

from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.scene.shelf_scene import Scene


def save_scene_model(setting: MethodSetting, scene: Scene, path: Path) -> None:
    """Write what a method solves for a scene.

    `micp` and `admm`: the mixed-integer program over the envelopes, as .lp, .mps or .cip. Other
    methods: the whole statement with its products, as SCIP's .cip. Raises UsageError for another
    suffix or an unwritable place, MissingSolver without PySCIPOpt.
    """
    # These load CasADi and SCIP: not before they are needed.
    from climbplan.bookshelf.methods.by_table import published_grid
    from climbplan.bookshelf.methods.judge import Judge
    from climbplan.reformulations.disjunctions import BigM
    from climbplan.solvers.model_file import save_model
    from climbplan.solvers.scip.bilinear import save_bilinear_model

    solver = setting.solver
    judge = Judge(scene.count, setting.shelf, setting.meaning)
    instance = judge.instance(scene)
    if solver.method not in ("micp", "admm"):
        save_bilinear_model(instance, path)
        return
    enveloped = published_grid(judge).apply(instance)
    save_model(BigM().apply(enveloped.instance).instance, path)
