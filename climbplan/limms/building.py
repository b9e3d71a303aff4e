"""A program while it is built: what its parts share."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from climbplan.limms.chain_symbols import chain_function
from climbplan.limms.scene import Scene
from climbplan.limms.statement import Limb
from climbplan.limms.unknowns import Unknowns


class Building:
    """Scene, limbs, unknowns and cost of a program, and where its last phase ended."""

    def __init__(self, scene: Scene, limbs: Sequence[Limb], store: Unknowns) -> None:
        self.scene, self.limbs, self.store = scene, limbs, store
        self.chain = chain_function(scene.module)
        self.cost = ca.MX(0)
        self.last: tuple[ca.MX, ca.MX, list[ca.MX]] | None = None  # p, v, q at the end
        self.first_p: ca.MX | None = None
        self.first_v: ca.MX | None = None
        self.footholds: list[ca.MX | None] = [None] * len(limbs)
