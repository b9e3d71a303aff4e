"""Dropped scenes are distributed like the published ones.

Against figures of the published set of 3537 scenes (stored books: width 24.6 mm, height 69.7 mm;
inserted: 27.9 and 68.9 mm; 66 % upright, 20 % flat, 14 % leaning; gaps from 3.3 mm on), and against
the published test set, where a file of it stands beside the checkout or where
CLIMBPLAN_PUBLISHED_SCENES says.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.stats import ks_2samp

from climbplan.bookshelf.scene.generator import DropRules, build_drop_shelf, generate_scenes
from climbplan.bookshelf.scene.rectangles import compute_separation
from climbplan.bookshelf.scene.shelf_scene import Scenes

pytest.importorskip("pymunk")

PUBLISHED = Path(
    os.environ.get(
        "CLIMBPLAN_PUBLISHED_SCENES",
        Path(__file__).parents[2] / ".." / "shared" / "data" / "bookshelf_published.h5",
    )
)
SCENES = 700
NEARLY_UPRIGHT = 0.05


@dataclass(frozen=True)
class Shares:
    """Shares of stored books, and of scenes in which all are upright."""

    upright: float
    flat: float
    leaning: float
    all_upright: float

    @property
    def without_upright_scenes(self) -> tuple[float, float, float]:
        """Of books in the other scenes: these do not depend on how many upright ones are kept."""
        rest = 1 - self.all_upright
        return (self.upright - self.all_upright) / rest, self.flat / rest, self.leaning / rest


def shares(scenes: Scenes) -> Shares:
    tilt = np.abs(scenes.pose[..., 2])
    upright, flat = tilt <= NEARLY_UPRIGHT, tilt > 1.5
    return Shares(
        float(upright.mean()),
        float(flat.mean()),
        float((~upright & ~flat).mean()),
        float(upright.all(axis=1).mean()),
    )


def gaps_mm(scenes: Scenes) -> np.ndarray:
    """Distances between stored neighbours."""
    return np.array(
        [
            1e3 * compute_separation(s.pose[k], s.size[k], s.pose[k + 1], s.size[k + 1])
            for s in scenes
            for k in range(s.count - 1)
        ]
    )


@pytest.fixture(scope="module")
def ours() -> Scenes:
    return generate_scenes(17, SCENES, 3)


def test_sizes_have_the_published_means(ours: Scenes) -> None:
    height, width = 1e3 * ours.size.mean(axis=(0, 1))
    assert width == pytest.approx(24.6, abs=1.0)
    assert height == pytest.approx(69.7, abs=1.0)
    height, width = 1e3 * ours.inserted.mean(axis=0)
    assert width == pytest.approx(27.9, abs=1.5)
    assert height == pytest.approx(68.9, abs=1.5)


def test_states_have_the_published_shares(ours: Scenes) -> None:
    found = shares(ours)
    assert found.upright == pytest.approx(0.66, abs=0.08)
    assert found.flat == pytest.approx(0.20, abs=0.06)
    assert found.leaning == pytest.approx(0.14, abs=0.04)
    assert found.all_upright == pytest.approx(0.20, abs=0.05)  # the published cap


def test_gaps_are_those_of_round_corners(ours: Scenes) -> None:
    gaps = gaps_mm(ours)
    assert np.percentile(gaps, 0.5) > 3.3
    assert gaps.min() > 2.5
    assert 0.3 < (gaps < 4.2).mean() < 0.55  # in contact


@pytest.mark.skipif(not PUBLISHED.is_file(), reason="the published scenes are not here")
def test_like_the_published_scenes(ours: Scenes) -> None:
    with h5py.File(PUBLISHED) as file:
        theirs = Scenes.from_theta(file["test_all/theta"][()], "mm")
    for axis in range(2):
        of_books = (1e3 * s.size[..., axis].mean() for s in (ours, theirs))
        assert np.subtract(*of_books) == pytest.approx(0, abs=1.5)
    found = shares(ours).without_upright_scenes
    for a, b in zip(found, shares(theirs).without_upright_scenes, strict=True):
        assert a == pytest.approx(b, abs=0.06)
    ours_in_contact, theirs_in_contact = ((gaps_mm(s) < 4.2).mean() for s in (ours, theirs))
    assert ours_in_contact == pytest.approx(theirs_in_contact, abs=0.06)
    # Places and gaps as wholes: the distance of two distributions, at most 1
    for name, values in {
        "gaps": (gaps_mm(ours), gaps_mm(theirs)),
        "x": (ours.pose[..., 0].ravel(), theirs.pose[..., 0].ravel()),
        "inserted width": (ours.inserted[:, 1], theirs.inserted[:, 1]),
    }.items():
        assert ks_2samp(*values).statistic < 0.12, name


def test_other_books_and_shelves_are_other_distributions() -> None:
    slender = replace(DropRules(), width_mm=(10, 18), room_mm=150.0)
    scenes = generate_scenes(17, 30, 3, slender)
    assert 1e3 * scenes.sizes[..., 1].max() <= 18 + 1e-9
    shelf = build_drop_shelf(3, slender)
    assert shelf.width == pytest.approx(0.150 - 0.01378, abs=1e-9)
    assert np.abs(scenes.pose[..., 0]).max() < shelf.right
