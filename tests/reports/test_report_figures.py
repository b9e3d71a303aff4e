"""Figures of climbs with few and many limbs and rounds: drawn, readable, nothing overlapping."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

from climbplan.climb.pages.cones import (
    compute_contact_forces,
    compute_force_scale,
    select_round_force,
)
from climbplan.climb.pages.figure_forces import select_instants
from climbplan.climb.pages.figure_region import region
from climbplan.climb.pages.report import select_figures
from climbplan.climb.pages.series import find_minimum
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.reports.sheet import format_plain, render_png

MakePlan = Callable[..., ClimbPlan]
BEAM = {"name": "beam", "lower": [-0.615, 0.4, 0.3], "upper": [0.615, 0.9, 0.5]}
CASES: dict[str, dict[str, object]] = {
    "three limbs, one round": {"limbs": 3, "rounds": 1},
    "six limbs round a beam": {"limbs": 6, "rounds": 8, "terrain": {"obstacles": [BEAM]}},
    "eight limbs, 32 rounds": {"limbs": 8, "rounds": 32, "goal": (0.0, 0.0, 3.2)},
    "in a tube": {"limbs": 6, "rounds": 4, "terrain": {"tube": {"radius": 0.62, "up": [-1, 2]}}},
}


@dataclass(frozen=True)
class Rendered:
    """A figure as written, and the pairs of its texts that cover each other."""

    image: bytes
    overlaps: list[tuple[str, str]]


def render(figure: Figure) -> Rendered:
    """Render a figure once and look at every text that was drawn."""
    drawn: dict[int, Text] = {}
    draw = Text.draw

    def recorded(text: Text, renderer: RendererBase, *args: object, **options: object) -> None:
        if text.get_visible() and text.get_text().strip():
            drawn[id(text)] = text
        draw(text, renderer, *args, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Text, "draw", recorded)
        image = render_png(figure)
    boxes = [(text.get_text(), text.get_window_extent()) for text in drawn.values()]
    assert len(boxes) > 5
    pairs = []
    for (first, a), (second, b) in itertools.combinations(boxes, 2):
        wide = min(a.x1, b.x1) - max(a.x0, b.x0)
        tall = min(a.y1, b.y1) - max(a.y0, b.y0)
        if wide > 1 and tall > 1:
            pairs.append((first, second))
    return Rendered(image, pairs)


@pytest.fixture(scope="module", params=CASES, ids=lambda name: name)
def plan(request: pytest.FixtureRequest, make_plan: MakePlan) -> ClimbPlan:
    return make_plan(**CASES[request.param])


@pytest.mark.parametrize("name", ["postures", "torque", "friction", "safety", "forces"])
def test_figures_are_drawn_without_overlapping_text(plan: ClimbPlan, name: str) -> None:
    figure = select_figures(plan)[name](plan)
    rendered = render(figure)
    image = rendered.image
    assert image.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", image[16:24])
    assert width >= 1200
    assert 300 <= height <= 2400
    assert rendered.overlaps == []


@pytest.mark.parametrize("name", ["torque", "friction"])
def test_every_limb_has_a_panel_with_limits_and_lifted_phases(plan: ClimbPlan, name: str) -> None:
    figure = select_figures(plan)[name](plan)
    panels = [ax for ax in figure.axes if ax.get_visible()]
    titles = {ax.get_title(loc="left") for ax in panels}
    assert titles == set(plan.robot.limb_names)
    for ax in panels:
        limb = plan.robot.limb_names.index(ax.get_title(loc="left"))
        lifts = int(plan.instants.lifted[:, limb].sum())
        (bars,) = (c for c in ax.collections if isinstance(c, PolyCollection))
        assert len(bars.get_paths()) == lifts == plan.rounds.count
        drawn = [np.asarray(line.get_ydata()) for line in ax.get_lines()]
        if name == "torque":
            failure = plan.robot.max_torque.max()
            assert any(np.allclose(y, failure) for y in drawn if len(y) == plan.instants.count)
        else:
            planned = plan.instants.mu[:, limb] / plan.limits.safety_friction
            assert any(len(y) == len(planned) and np.allclose(y, planned) for y in drawn)


def test_axes_carry_units(make_plan: MakePlan) -> None:
    plan = make_plan(limbs=6, rounds=2)
    figures = select_figures(plan)
    front, side = figures["postures"](plan).axes[1:]
    assert (front.get_xlabel(), front.get_ylabel()) == ("x [m]", "z [m]")
    assert (side.get_xlabel(), side.get_ylabel()) == ("y [m]", "z [m]")
    assert "[N m]" in figures["torque"](plan).axes[0].get_ylabel()
    assert any("N" in text.get_text() for text in figures["forces"](plan).axes[0].texts)


def region_study(two: bool) -> Study:
    friction = np.array([0.4, 0.8, 1.2])
    if not two:
        keys, values = ("terrain.friction",), (friction,)
        return Study(keys, values, np.array([[1], [0], [0]]), ("slips", "", ""))
    angles = np.array([0.0, 10.0, 20.0, 40.0])
    label = np.array([[1, 0, 0], [1, 0, 0], [1, 1, 0], [2, 2, 2]])
    keys = ("terrain.walls.angle_deg", "terrain.friction")
    return Study(keys, (angles, friction), label, tuple("x" * 12))


@pytest.mark.parametrize("two", [True, False])
def test_region_shows_labels_and_the_plan_itself(make_plan: MakePlan, two: bool) -> None:
    plan = make_plan(limbs=6, rounds=1, study=region_study(two))
    figure = select_figures(plan)["region"](plan)
    rendered = render(figure)
    ax = figure.axes[0]
    assert ax.get_xlabel() == ("terrain.walls.angle_deg [deg]" if two else "terrain.friction")
    star = ax.get_lines()[-1]
    expected = (0.0, 1.0) if two else (1.0, 0.5)
    assert (star.get_xdata()[0], star.get_ydata()[0]) == expected
    legend = [text.get_text().strip() for text in figure.legends[0].get_texts()]
    counts = (5, 4, 3) if two else (2, 1, 0)
    assert legend == [
        *(f"{name} ({n})" for name, n in zip(Study.LABELS, counts, strict=True)),
        "this plan",
    ]
    assert rendered.overlaps == []


def test_region_needs_a_study(make_plan: MakePlan) -> None:
    plan = make_plan(limbs=6, rounds=1)
    assert "region" not in select_figures(plan)
    with pytest.raises(ValueError, match="no study"):
        region(plan)


def test_cones_are_cut_where_the_force_ends(make_plan: MakePlan) -> None:
    plan = make_plan(limbs=6, rounds=2)
    scale = compute_force_scale(plan, 0.3)
    assert np.linalg.norm(plan.forces.force, axis=-1).max() * scale == pytest.approx(0.3)
    for k in select_instants(plan):
        found = compute_contact_forces(plan, k, scale)
        assert [f.limb for f in found] == list(np.flatnonzero(plan.instants.contact[k]))
        for force in found:
            normal = plan.instants.normal[k, force.limb]
            cut = (force.outer - force.toe) @ normal
            assert np.allclose(cut, (force.tip - force.toe) @ normal)
            center = force.outer.mean(axis=0)
            off = np.linalg.norm(force.tip - center)
            radius = np.linalg.norm(force.outer - center, axis=1)
            inner = np.linalg.norm(force.inner - center, axis=1)
            assert np.allclose(radius, plan.instants.mu[k, force.limb] * cut[0])
            assert np.allclose(radius / inner, plan.limits.safety_friction)
            # Inside the outer ring exactly if the contact holds.
            holds = plan.forces.mu_critical[k, force.limb] <= plan.instants.mu[k, force.limb]
            assert (off <= radius[0] + 1e-12) == holds


def test_chosen_instants_hold_the_critical_ones(make_plan: MakePlan) -> None:
    plan = make_plan(limbs=6, rounds=3)
    picked = select_instants(plan)
    assert len(picked) == 4
    assert picked == sorted(set(picked))
    assert int(np.argmin(plan.forces.safety_torque)) in picked
    assert int(np.argmin(plan.forces.safety_friction)) in picked
    assert plan.instants.count - 1 in picked


def test_of_many_instants_at_a_bound_the_first_is_named() -> None:
    assert find_minimum(np.array([3.0, 1.8 + 1e-9, 1.8, 1.8 - 1e-9, 2.0])) == 1
    assert find_minimum(np.array([3.0, 1.8, 1.7])) == 2
    assert find_minimum(np.array([np.inf, np.inf])) == 0


@pytest.mark.parametrize(("scale", "newtons"), [(0.01, 20.0), (0.001, 200.0), (0.005, 50.0)])
def test_scale_arrow_is_a_round_number(scale: float, newtons: float) -> None:
    assert select_round_force(scale, 0.25) == newtons


def test_names_from_a_spec_are_drawn_as_they_are(make_plan: MakePlan) -> None:
    plan = make_plan(limbs=3, rounds=1, name=r"$\frac{1}{0 {_name} 攀登")
    names = tuple(f"$_{i} " + 30 * "long" for i in range(3))
    plan = replace(plan, robot=replace(plan.robot, limb_names=names, name=90 * "$W"))
    for draw in select_figures(plan).values():
        assert render(draw(plan)).overlaps == []
    assert format_plain("a $x$ 攀") == r"a \$x\$ □"
