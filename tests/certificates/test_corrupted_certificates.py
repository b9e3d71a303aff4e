"""Corrupted and forged certificates: nothing false is proved, and what is claimed is lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from certified_programs import Certified, certified_products, certified_program

from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import check


def _without_a_leaf(c: Certificate, rng: np.random.Generator) -> Certificate:
    gone = int(rng.integers(len(c.empty)))
    node = np.flatnonzero(c.split < 0)[gone]
    kept = np.delete(np.arange(len(c.empty)), gone)
    return replace(
        c,
        split=np.delete(c.split, node),
        at=np.delete(c.at, node),
        point=c.point[kept],
        multiplier=c.multiplier[kept],
        ball=c.ball[kept],
        empty=c.empty[kept],
    )


def _joined_leaves(c: Certificate, rng: np.random.Generator) -> Certificate:
    """One side of a split for the whole of it."""
    leaf = c.split < 0
    splits = np.flatnonzero(~leaf[:-2] & leaf[1:-1] & leaf[2:])
    node = int(splits[rng.integers(len(splits))])
    gone = int(leaf[: node + 1 + rng.integers(2)].sum())
    kept = np.delete(np.arange(len(c.empty)), gone)
    return replace(
        c,
        split=np.delete(c.split, [node, node + 1]),
        at=np.delete(c.at, [node, node + 1]),
        point=c.point[kept],
        multiplier=c.multiplier[kept],
        ball=c.ball[kept],
        empty=c.empty[kept],
    )


def _moved_split(c: Certificate, rng: np.random.Generator) -> Certificate:
    at, node = c.at.copy(), rng.choice(np.flatnonzero(c.split >= 0))
    at[node] += rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 3.0)
    return replace(c, at=at)


def _other_variable(c: Certificate, rng: np.random.Generator) -> Certificate:
    split, node = c.split.copy(), rng.choice(np.flatnonzero(c.split >= 0))
    split[node] = rng.integers(c.point.shape[1])
    return replace(c, split=split)


def _other_order(c: Certificate, rng: np.random.Generator) -> Certificate:
    order = rng.permutation(len(c.empty))
    return replace(
        c,
        point=c.point[order],
        multiplier=c.multiplier[order],
        ball=c.ball[order],
        empty=c.empty[order],
    )


def _other_multipliers(c: Certificate, rng: np.random.Generator) -> Certificate:
    changed = c.multiplier.copy()
    changed.data = changed.data * rng.uniform(0.2, 3.0, len(changed.data))
    return replace(c, multiplier=changed, ball=c.ball * rng.uniform(0.2, 3.0, c.ball.shape))


def _flipped_sides(c: Certificate, rng: np.random.Generator) -> Certificate:
    return replace(c, multiplier=-c.multiplier)


def _all_empty(c: Certificate, rng: np.random.Generator) -> Certificate:
    return replace(c, empty=np.ones_like(c.empty), bound=np.inf)


def _elsewhere(c: Certificate, rng: np.random.Generator) -> Certificate:
    return replace(c, point=c.point + rng.normal(size=c.point.shape))


_FATAL = (_without_a_leaf, _all_empty)
_CORRUPTIONS = (
    *_FATAL,
    _joined_leaves,
    _moved_split,
    _other_variable,
    _other_order,
    _other_multipliers,
    _flipped_sides,
    _elsewhere,
)


@pytest.mark.parametrize("made", [certified_program, certified_products])
@pytest.mark.parametrize("corrupted", _CORRUPTIONS)
def test_corrupted_certificates_prove_nothing_false(
    corrupted: Callable[[Certificate, np.random.Generator], Certificate],
    made: Callable[[int], Certified],
) -> None:
    rng = np.random.default_rng(1)
    tried = 0
    for seed in range(30 if made is certified_program else 8):
        instance, found, certificate = made(seed)
        if found.objective is None or len(certificate.empty) < 2:
            continue
        tried += 1
        bad = corrupted(certificate, rng)
        verdict = check(instance, bad)
        assert verdict.bound <= found.objective + 1e-5 * (1.0 + abs(found.objective))
        if corrupted in _FATAL:
            assert verdict.bound < bad.bound
    assert tried >= 7


@pytest.mark.slow
@pytest.mark.parametrize("made", [certified_program, certified_products])
def test_a_hundred_corrupted_certificates_lose_what_they_claimed(
    made: Callable[[int], Certified],
) -> None:
    rng = np.random.default_rng(2)
    rejected = 0
    for seed in range(75 if made is certified_program else 45):
        instance, found, certificate = made(seed)
        if found.objective is None or len(certificate.empty) < 2:
            continue
        # More than the answer costs is false, whatever else is changed
        beyond = found.objective + 1e-3 * (1.0 + abs(found.objective))
        forged = [corrupted(certificate, rng) for corrupted in _FATAL]
        others = [corrupted(certificate, rng) for corrupted in _CORRUPTIONS[len(_FATAL) :]]
        forged += [replace(other, bound=beyond) for other in (certificate, *others)]
        for bad in forged:
            assert check(instance, bad).bound < bad.bound
            rejected += 1
    assert rejected >= 100
