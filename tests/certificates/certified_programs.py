"""Programs with their answers and certificates, made once for all tests of a run."""

from __future__ import annotations

from functools import cache

from random_products import random_products
from random_programs import random_program

from climbplan.certificates.certificate import Certificate
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.spatial_method import WarmStartedSpatialTree
from climbplan.solvers.result import SolverResult

GAP = 1e-5
PRODUCTS_GAP = 1e-4

Certified = tuple[Instance, SolverResult, Certificate]


def proved(instance: Instance, gap: float = GAP) -> tuple[SolverResult, Certificate]:
    """By the tree over integers, and where there are products by that over space."""
    tree: WarmStartedTree | WarmStartedSpatialTree
    if instance.products.count:
        tree = WarmStartedSpatialTree(gap, 1e-6, proves=True)
    else:
        tree = WarmStartedTree(gap, 1e-6, proves=True)
    found = tree.solve(instance, 60.0)
    assert tree.certificate is not None
    return found, tree.certificate


@cache
def certified_program(seed: int) -> Certified:
    """A random program with integers, alternatives and balls."""
    instance = random_program(seed).instantiate({})
    return instance, *proved(instance)


@cache
def certified_products(seed: int) -> Certified:
    """A random program with products."""
    instance = random_products(seed).instantiate({})
    return instance, *proved(instance, PRODUCTS_GAP)
