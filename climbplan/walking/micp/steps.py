"""Steps on parts of tubes: each proves more of one, and hands back what is left of it in parts.

The head of the first intervals draws ranges closer, then contacts of the first two intervals make
parts, the head of the first four draws those, and contacts of these four make parts of them. What
is left of one is halved in its ranges. Where contacts of the first intervals decide little, longer
heads are drawn for as long as they gain, and the tube is searched as it is.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.walking.micp.bounding import SAG_SEARCHED, Bounding
from climbplan.walking.micp.heads import WORTH, drawn_by_head, later_than
from climbplan.walking.micp.parts import Part, by_contacts, early_of, halves
from climbplan.walking.micp.ranges import Box

_LITTLE = 0.001  # of the cost: where halves gain no more, contacts are searched first
_NEAR = 0.004  # of the cost that is missing, and parts are searched before they are halved


def step(run: Bounding, part: Part) -> list[Part]:
    """Prove more of a part: what is left of it, in parts; none if there is nothing to part.

    First the heads of the first intervals, then contacts of those, and then halves of ranges.
    """
    stated, most, box = part.stated, part.stated.most, part.box
    if part.later is None:
        program = stated.program(box)
        if box is None:
            if not run.tighten(program, most)[0] or run.closed or run.left <= 0:
                return []
            stated = run.spared(stated)
            program = stated.program(None)
        later = later_than(program, part.head)
        if later is None:
            run.nothing_cheaper(most)
            return []
        part, box = replace(part, stated=stated, later=later), program.box
    assert box is not None  # what is known later of has one
    return _drawn(run, part, box)


def _drawn(run: Bounding, part: Part, box: Box) -> list[Part]:
    """A part with ranges that its head draws closer, parted if more is left."""
    stated, most, basis = part.stated, part.stated.most, run.objective
    later = {part.head: part.later or 0.0}
    found = drawn_by_head(stated, box, part.head, later, 0, run.left, run.limits.clock)
    if found is None:
        run.nothing_cheaper(most)
        return []
    program = stated.program(found)
    if not run.tighten(program, most, ())[0] or run.closed:
        return []
    before, knots = part.bound, stated.task.knots
    part = replace(part, box=found, bound=run.bounds[run.at])
    if run.left <= 0:
        return [part]
    if part.decided < early_of(stated):
        sag = SAG_SEARCHED * run.objective
        few = by_contacts(part, program, sag, lambda: run.left > 0)
        if few is None and part.bound >= before + WORTH * most and part.head + 1 < knots:
            return [replace(part, head=part.head + 1, later=None)]
        if few is None:
            run.search(part, program)
            return []
        parts = few
    else:
        two, missing = halves(part), most - part.bound
        if two is None or missing <= _NEAR * basis or two.gain < _LITTLE * basis:
            run.search(part, program, briefly=two is not None)
            if two is None or run.closed:
                return []
        known = run.bounds[run.at]
        parts = [replace(one, bound=max(one.bound, known)) for one in two.parts]
    if not parts:
        run.nothing_cheaper(most)
    return parts
