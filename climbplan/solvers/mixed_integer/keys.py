"""Names of rows that stay the same while parameters change: what multipliers are kept by.

A key is one number: a variable's bound, a plain row, a conditional row, a pair of sides of two
conditional rows, a side's big-M row, the range of a factor or product in space, or one of the four
planes of a product's envelope, in this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import IntArray

VARIABLE, PLAIN, CONDITION, PAIR, BIG_M = range(5)  # what a row comes from


@dataclass(frozen=True)
class KeySpace:
    """Keys of a form with some variables, plain rows and conditional rows."""

    variables: int
    rows: int
    conditions: int
    products: int = 0  # place of the first product among the variables

    @property
    def plain(self) -> int:
        """Key of the first plain row."""
        return self.variables

    @property
    def conditional(self) -> int:
        """Key of the first conditional row."""
        return self.variables + self.rows

    @property
    def _pairs(self) -> int:
        return self.conditional + self.conditions

    @property
    def _big_m(self) -> int:
        return self._pairs + 4 * self.conditions**2

    def pair(self, a: IntArray, sign_a: ArrayLike, c: IntArray, sign_c: ArrayLike) -> IntArray:
        """Keys of pairs of sides: 1 for a row's upper bound, -1 for its lower one."""
        first = 2 * a + (np.asarray(sign_a) < 0)
        return self._pairs + (first * self.conditions + c) * 2 + (np.asarray(sign_c) < 0)

    def big_m(self, row: IntArray, sign: float) -> IntArray:
        """Keys of big-M rows."""
        return self._big_m + 2 * row + int(sign < 0)

    @property
    def _ranges(self) -> int:
        return self._big_m + 2 * self.conditions

    @property
    def _envelopes(self) -> int:
        return self._ranges + self.variables

    def ranges(self, variable: IntArray) -> IntArray:
        """Keys of the rows that hold values of factors and products."""
        return self._ranges + variable

    def envelopes(self, count: int) -> IntArray:
        """Keys of the planes of all products' envelopes, four by four."""
        return self._envelopes + np.arange(4 * count)

    def parts(self, key: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """What a row is made of: its kind, two rows of the form, and which sides of these.

        Kinds are `VARIABLE`, `PLAIN`, `CONDITION`, `PAIR` and `BIG_M`, and -1 for ranges in space
        and planes of envelopes; rows (m, 2) are counted among conditional ones but for plain ones,
        the second is -1 but for pairs; sides (m, 2) are 1 and -1, and 0 where the row itself has
        both.
        """
        first = [self.plain, self.conditional, self._pairs, self._big_m, self._ranges]
        kind = np.searchsorted(first, key, "right")
        kind[key >= self._ranges] = -1
        row, side = np.full((len(key), 2), -1), np.zeros((len(key), 2), int)
        for number, begin in ((VARIABLE, 0), (PLAIN, self.plain), (CONDITION, self.conditional)):
            row[kind == number, 0] = key[kind == number] - begin
        here = kind == PAIR
        rest, side_c = np.divmod(key[here] - self._pairs, 2)
        upper, c = np.divmod(rest, max(self.conditions, 1))
        a, side_a = np.divmod(upper, 2)
        row[here] = np.stack([a, c], axis=1)
        side[here] = 1 - 2 * np.stack([side_a, side_c], axis=1)
        here = kind == BIG_M
        row[here, 0], side_b = np.divmod(key[here] - self._big_m, 2)
        side[here, 0] = 1 - 2 * side_b
        return kind, row, side

    def moved(
        self, key: IntArray, variable: IntArray, row: IntArray, condition: IntArray
    ) -> IntArray:
        """Keys with every variable, row and condition replaced; -1 where that is nowhere."""
        out = np.full(len(key), -1)
        ends = [self.plain, self.conditional, self._pairs, self._big_m]
        kind = np.searchsorted([*ends, self._ranges, self._envelopes], key, "right")
        here = kind == 0
        out[here] = variable[key[here]]
        for number, begin, to in ((1, self.plain, row), (2, self.conditional, condition)):
            here = kind == number
            place = to[key[here] - begin]
            out[here] = np.where(place >= 0, begin + place, -1)
        here = kind == 3
        rest, sign_c = np.divmod(key[here] - self._pairs, 2)
        first, c = np.divmod(rest, max(self.conditions, 1))
        a, sign_a = np.divmod(first, 2)
        a, c = condition[a], condition[c]
        again = self._pairs + ((2 * a + sign_a) * self.conditions + c) * 2 + sign_c
        out[here] = np.where((a >= 0) & (c >= 0), again, -1)
        here = kind == 4
        at, sign = np.divmod(key[here] - self._big_m, 2)
        out[here] = np.where(condition[at] >= 0, self._big_m + 2 * condition[at] + sign, -1)
        here = kind == 5
        at = variable[key[here] - self._ranges]
        out[here] = np.where(at >= 0, self._ranges + at, -1)
        here = kind == 6
        product, plane = np.divmod(key[here] - self._envelopes, 4)
        at = variable[self.products + product]
        out[here] = np.where(at >= 0, self._envelopes + 4 * (at - self.products) + plane, -1)
        return out


def places(key: IntArray, among: IntArray) -> IntArray:
    """Where each key stands among others, -1 where it does not."""
    order = np.argsort(among, kind="stable")
    at = np.minimum(np.searchsorted(among[order], key), max(len(among) - 1, 0))
    if not len(among):
        return np.full(len(key), -1)
    found = order[at]
    return np.where((among[found] == key) & (key >= 0), found, -1)
