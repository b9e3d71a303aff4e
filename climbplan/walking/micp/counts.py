"""How many legs stand: vertical forces and velocities of each number apart, so that mixtures cost.

Relaxed contacts would have the body walk on all legs at once that stand by half each: no two
forces differ, and the body never falls. Therefore each knot has shares of 0 to all standing legs,
with vertical forces and velocities of their own and squares in perspective form: the convex hull
over the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.robots.leg_order import contrasts
from climbplan.walking.micp.legs import Legs
from climbplan.walking.micp.model import Lin, total
from climbplan.walking.micp.pieces import Piece


@dataclass(frozen=True)
class Count:
    """So many legs stand at a knot: the binary, and what holds if it is chosen."""

    legs: int
    chosen: Lin
    force: Lin  # vertical, in units of force
    before: Lin  # vertical velocity at the knot
    after: Lin  # and at the next one


class Counts(Legs):
    """Rows and squares of each knot by the number of standing legs."""

    def counts(self, n: int, legs: tuple[tuple[Piece, ...], ...]) -> tuple[Count, ...]:
        """Shares of as many standing legs as may be at a knot, and what they add up to."""
        model, box = self.model, self.box
        least = max(self.task.least_contacts, round(box.stands_low[n].sum()))
        most = round(box.stands_high[n].sum())
        found = tuple(self.of_count(n, m) for m in range(least, most + 1))
        contacts = [total(q.chosen for q in leg) for leg in legs]
        model.add("gait.contacts", total(one.chosen for one in found), 1.0, 1.0)
        standing = total(one.chosen * float(one.legs) for one in found)
        model.add("gait.contacts", standing - total(contacts), 0.0, 0.0)
        for contact in contacts:
            if most == self.legs and least <= most:
                model.least("gait.contacts", contact - found[-1].chosen)
            if least == 0 and least <= most:
                model.least("gait.contacts", 1.0 - contact - found[0].chosen)
        pushed = total(q.force[2] for leg in legs for q in leg)
        model.add("gait.contacts", total(one.force for one in found) - pushed, 0.0, 0.0)
        model.add("gait.contacts", total(one.before for one in found) - self.v[n][2], 0.0, 0.0)
        return found

    def of_count(self, n: int, legs: int) -> Count:
        task, model = self.task, self.model
        chosen = model.variable(0.0, 1.0, whole=True)
        force = self.scaled("force.limit", chosen, 0.0, legs * self.most)
        before = self.scaled(
            "dynamics.velocity", chosen, float(self.v_low[n, 2]), float(self.v_high[n, 2])
        )
        gain = task.step * self.unit / task.body.mass
        after = before + force * gain - chosen * (task.step * task.body.gravity)
        model.least("dynamics.velocity", after - chosen * float(self.v_low[n + 1, 2]))
        model.least("dynamics.velocity", chosen * float(self.v_high[n + 1, 2]) - after)
        return Count(legs, chosen, force, before, after)

    def tracking(self, n: int, come: tuple[Count, ...], go: tuple[Count, ...]) -> None:
        """Cost of the velocity at a knot after 0, and of the step that it makes.

        It is at least that of the velocities of numbers that stood before, and of those that stand
        from there on (go: none at the last knot).
        """
        task, model, w = self.task, self.model, self.task.weights
        motion = w.motion * task.step**2 if n < task.knots else 0.0
        for k in range(3):
            track, wanted = float(w.velocity[k]), float(task.reference.velocity[n - 1, k])
            weight = track + motion
            if weight == 0.0:
                continue
            middle = track * wanted / weight
            model.constant += track * wanted**2 - weight * middle**2
            ends = float(self.v_low[n, k]) - middle, float(self.v_high[n, k]) - middle
            if k < 2:
                paid = self.square("cost.tracking", weight, self.v[n][k] - middle, ends)
                if n < task.knots and paid.terms:
                    self.aside[k].append(paid.column)
                elif n < task.knots:
                    self.given[k] += paid.constant
                continue
            cost = model.variable(0.0, model.dearest, cost=1.0)
            for shares in ([(c.after, c) for c in come], [(c.before, c) for c in go]):
                squares = [
                    self.square(
                        "cost.tracking", weight, v - c.chosen * middle, ends, c.chosen, cost=0.0
                    )
                    for v, c in shares
                ]
                model.least("cost.tracking", cost - total(squares))

    def differences(self, legs: tuple[tuple[Piece, ...], ...], counts: tuple[Count, ...]) -> None:
        """Cost of differences of forces: a sum F on m legs costs at least 2 (L / m - 1) F^2.

        Squares over ordered pairs of legs are 2 L times those of L - 1 orthonormal contrasts.
        """
        model, weight = self.model, self.task.weights.force_difference * self.unit**2
        if weight == 0.0:
            return
        vertical = []
        for k in range(3):
            forces = [total(q.force[k] for q in leg) for leg in legs]
            for signs in contrasts(self.legs):
                contrast = total(f * float(s) for f, s in zip(forces, signs, strict=True))
                price = 0.0 if k == 2 else 1.0
                square = self.square(
                    "cost.force_difference", 2.0 * self.legs * weight, contrast, cost=price
                )
                if k == 2:
                    vertical.append(square)
        cost = model.variable(0.0, model.dearest, cost=1.0)
        sums = [
            self.square(
                "cost.force_difference",
                2.0 * (self.legs / one.legs - 1.0) * weight,
                one.force,
                (0.0, one.legs * self.most),
                one.chosen,
                cost=0.0,
            )
            for one in counts
            if 0 < one.legs < self.legs
        ]
        model.least("cost.force_difference", cost - total(vertical))
        model.least("cost.force_difference", cost - total(sums))

    def square(
        self,
        name: str,
        weight: float,
        value: Lin,
        ends: tuple[float, float] | None = None,
        share: Lin | None = None,
        cost: float = 1.0,
    ) -> Lin:
        """As of `LinearModel.square`, up to where it alone costs all; ends: of the value."""
        model = self.model
        if share is None and all(model.lower[c] == model.upper[c] for c in value.terms):
            fixed = sum(f * model.lower[c] for c, f in value.terms.items())
            value = Lin(constant=value.constant + fixed)
        low, high = ends if ends is not None else self.extent(value)
        reach = float(np.sqrt(self.cost / max(weight, 1e-12)))
        low, high = max(low, -reach), min(high, reach)
        return model.square(name, weight, value, (low, high), self.ratio, share, cost)
