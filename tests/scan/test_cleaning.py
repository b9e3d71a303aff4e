"""Scans put in order: what is wrong with them is mended and told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_surfaces import block, box, grid, joined, plate, tube

from climbplan.scan import cleaning
from climbplan.scan.body_holds import find_closed_bodies
from climbplan.scan.cleaning import clean_mesh, remove_outliers
from climbplan.scan.clouds import build_cloud
from climbplan.scan.orienting import orient_to_free_space
from climbplan.scan.raw import RawScan, ScanError, build_mesh, select_triangles
from climbplan.scan.relief import triangulate_cloud


def normals(raw: RawScan) -> np.ndarray:
    corners = raw.corners
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def said(raw: RawScan, words: str) -> bool:
    return any(words in note for note in raw.notes)


def test_repeated_and_empty_triangles_are_left_out() -> None:
    raw = block().raw
    extra = np.array([raw.triangles[0], np.roll(raw.triangles[1], 1), [0, 1, 1]])
    clean = clean_mesh(build_mesh(raw.vertices, np.concatenate([raw.triangles, extra])))
    assert len(clean.triangles) == 12
    assert said(clean, "1 triangles without an area")
    assert said(clean, "2 repeated triangles")


def test_triangles_wound_against_their_surface_are_turned_round() -> None:
    raw = plate().raw
    wrong = raw.triangles.copy()
    wrong[::7] = wrong[::7, ::-1]
    clean = clean_mesh(build_mesh(raw.vertices, wrong))
    assert said(clean, "turned round")
    assert (normals(clean) @ [0, -0.6, 0.8] > 0).all()


def test_a_scan_of_too_many_triangles_is_thinned_and_told(monkeypatch) -> None:
    monkeypatch.setattr(cleaning, "MAX_TRIANGLES", 1000)
    line = np.linspace(0, 1, 61)
    raw = grid(line, line, lambda u, v: 0.02 * np.sin(4 * u) * np.cos(3 * v))
    thin = clean_mesh(raw)
    assert 200 < len(thin.triangles) <= 1000
    assert said(thin, f"{len(raw.triangles)} triangles thinned to {len(thin.triangles)}")


def test_thinning_does_not_depend_on_the_order_of_the_file(monkeypatch) -> None:
    monkeypatch.setattr(cleaning, "MAX_TRIANGLES", 500)
    line = np.linspace(0, 1, 41)
    raw = grid(line, line, lambda u, v: 0.1 * np.sin(4 * u + v))
    soup = build_mesh(raw.corners.reshape(-1, 3), np.arange(3 * len(raw.triangles)).reshape(-1, 3))
    order = np.random.default_rng(1).permutation(len(soup.triangles))
    thin, shuffled = clean_mesh(soup), clean_mesh(build_mesh(soup.vertices, soup.triangles[order]))
    assert np.array_equal(thin.vertices, shuffled.vertices)
    assert np.array_equal(thin.triangles, shuffled.triangles)
    assert said(thin, "at most 500 are used; corners moved by up to")
    z = 0.1 * np.sin(4 * thin.vertices[:, 0] + thin.vertices[:, 1])
    assert np.abs(thin.vertices[:, 2] - z).max() < 0.02


def test_bodies_and_sheets_turn_to_face_the_free_place() -> None:
    inside_out = block().raw
    inside_out = replace(inside_out, triangles=inside_out.triangles[:, ::-1])
    outside = orient_to_free_space(clean_mesh(inside_out), np.array([3.0, 0, 0]))
    middle = outside.corners.mean(axis=1) - [0.25, 0.2, 0.15]
    assert ((normals(outside) * middle).sum(axis=1) > 0).all()
    room = orient_to_free_space(clean_mesh(box((0, 0, 0), (3, 3, 3))), np.array([1.0, 1, 1]))
    assert ((normals(room) * (room.corners.mean(axis=1) - 1.5)).sum(axis=1) < 0).all()
    under = orient_to_free_space(clean_mesh(plate().raw), np.array([0.5, 1.0, -1.0]))
    assert (normals(under) @ [0, -0.6, 0.8] < 0).all()
    kept = orient_to_free_space(clean_mesh(tube().raw), np.array([0, 0, 0.5]))
    assert not said(kept, "turned to face")


def test_a_cloud_loses_outliers_and_becomes_a_relief() -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0, 1, (3000, 2)), rng.normal(0, 5e-4, 3000)])
    points = np.concatenate([points, [[0.5, 0.5, 3.0], [9, 9, 9]]])
    clean = remove_outliers(build_cloud(points))
    assert said(clean, "2 outliers")
    surface = clean_mesh(triangulate_cloud(clean, Path("cloud.xyz")))
    assert np.linalg.norm(normals(surface), axis=1).sum() / 2 == pytest.approx(1.0, abs=0.05)
    assert (normals(surface)[:, 2] > 0).all()


def test_a_cloud_that_folds_over_itself_is_refused() -> None:
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    with pytest.raises(ScanError, match=r"one above another.*expected a relief"):
        triangulate_cloud(build_cloud(ball), Path("ball.xyz"))


def test_two_bodies_keep_their_own_sides() -> None:
    raw = joined(box((0, 0, 0), (1, 1, 1)), box((2, 0, 0), (3, 1, 1)))
    turned = raw.triangles.copy()
    turned[12:] = turned[12:, ::-1]
    free = orient_to_free_space(
        clean_mesh(build_mesh(raw.vertices, turned)), np.array([1.5, 0.5, 0.5])
    )
    assert said(free, "1 surface of 12 triangles")


def test_closed_boxes_that_touch_along_edges_are_closed() -> None:
    """Four triangles meet where two boxes of a staircase touch; only two would be neighbours."""
    steps = [box((0, k, k), (1, k + 1, k + 1)) for k in range(5)]
    clean = clean_mesh(joined(*steps))
    assert not said(clean, "open edge")
    assert find_closed_bodies(clean).all()


def test_open_edges_are_counted_once_each() -> None:
    lid = select_triangles(box((0, 0, 0), (1, 1, 1)), np.arange(12) >= 2)  # without its top
    touched = joined(lid, box((0, 1, 1), (1, 2, 2)))  # a box on one of the four borders
    assert said(clean_mesh(lid), "4 open edges (borders and holes)")
    assert said(clean_mesh(touched), "4 open edges")
