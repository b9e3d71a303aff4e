"""Keys of rows that do not depend on parameters, by which multipliers are stored.

A key is one number. In this order it stands for a variable's bound, a plain row, an indicator row,
a pair of sides of two indicator rows, a side's big-M row, the range of a factor or product in
space, or one of the four planes of a product's envelope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import IntArray

VARIABLE, PLAIN, CONDITION, PAIR, BIG_M = range(5)  # origin of a row


@dataclass(frozen=True)
class KeySpace:
    """Keys for a form with some variables, plain rows and indicator rows."""

    variables: int
    rows: int
    conditions: int
    products: int = 0  # index of the first product among the variables

    @property
    def first_plain(self) -> int:
        """Key of the first plain row."""
        return self.variables

    @property
    def first_conditional(self) -> int:
        """Key of the first indicator row."""
        return self.variables + self.rows

    @property
    def _pairs(self) -> int:
        return self.first_conditional + self.conditions

    @property
    def _big_m(self) -> int:
        return self._pairs + 4 * self.conditions**2

    def encode_pair(
        self, a: IntArray, sign_a: ArrayLike, c: IntArray, sign_c: ArrayLike
    ) -> IntArray:
        """Return keys of pairs of sides: sign 1 for a row's upper bound, -1 for its lower one."""
        first = 2 * a + (np.asarray(sign_a) < 0)
        return self._pairs + (first * self.conditions + c) * 2 + (np.asarray(sign_c) < 0)

    def encode_big_m(self, row: IntArray, sign: float) -> IntArray:
        """Return keys of big-M rows."""
        return self._big_m + 2 * row + int(sign < 0)

    @property
    def _ranges(self) -> int:
        return self._big_m + 2 * self.conditions

    @property
    def _envelopes(self) -> int:
        return self._ranges + self.variables

    def encode_ranges(self, variable: IntArray) -> IntArray:
        """Return keys of the rows that hold values of factors and products."""
        return self._ranges + variable

    def encode_envelopes(self, count: int) -> IntArray:
        """Return keys of the planes of all products' envelopes, four for each product."""
        return self._envelopes + np.arange(4 * count)

    def decode(self, key: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Decode keys into kinds, rows of the form, and sides of these.

        Returns:
            kind: (m,) `VARIABLE`, `PLAIN`, `CONDITION`, `PAIR` or `BIG_M`, -1 for ranges in space
                and planes of envelopes.
            row: (m, 2) index among plain or indicator rows; the second is -1 except for pairs.
            side: (m, 2) 1 for an upper and -1 for a lower side, 0 where the row has both.
        """
        first = [self.first_plain, self.first_conditional, self._pairs, self._big_m, self._ranges]
        kind = np.searchsorted(first, key, "right")
        kind[key >= self._ranges] = -1
        row, side = np.full((len(key), 2), -1), np.zeros((len(key), 2), int)
        for number, begin in (
            (VARIABLE, 0),
            (PLAIN, self.first_plain),
            (CONDITION, self.first_conditional),
        ):
            row[kind == number, 0] = key[kind == number] - begin
        mask = kind == PAIR
        quotient, side_c = np.divmod(key[mask] - self._pairs, 2)
        upper, c = np.divmod(quotient, max(self.conditions, 1))
        a, side_a = np.divmod(upper, 2)
        row[mask] = np.stack([a, c], axis=1)
        side[mask] = 1 - 2 * np.stack([side_a, side_c], axis=1)
        mask = kind == BIG_M
        row[mask, 0], side_b = np.divmod(key[mask] - self._big_m, 2)
        side[mask, 0] = 1 - 2 * side_b
        return kind, row, side

    def remap(
        self, key: IntArray, variable: IntArray, row: IntArray, condition: IntArray
    ) -> IntArray:
        """Replace every variable, row and condition in keys; -1 where one has no image."""
        out = np.full(len(key), -1)
        ends = [self.first_plain, self.first_conditional, self._pairs, self._big_m]
        kind = np.searchsorted([*ends, self._ranges, self._envelopes], key, "right")
        mask = kind == 0
        out[mask] = variable[key[mask]]
        for number, begin, to in (
            (1, self.first_plain, row),
            (2, self.first_conditional, condition),
        ):
            mask = kind == number
            image = to[key[mask] - begin]
            out[mask] = np.where(image >= 0, begin + image, -1)
        mask = kind == 3
        quotient, sign_c = np.divmod(key[mask] - self._pairs, 2)
        first, c = np.divmod(quotient, max(self.conditions, 1))
        a, sign_a = np.divmod(first, 2)
        a, c = condition[a], condition[c]
        pair_key = self._pairs + ((2 * a + sign_a) * self.conditions + c) * 2 + sign_c
        out[mask] = np.where((a >= 0) & (c >= 0), pair_key, -1)
        mask = kind == 4
        index, sign = np.divmod(key[mask] - self._big_m, 2)
        out[mask] = np.where(condition[index] >= 0, self._big_m + 2 * condition[index] + sign, -1)
        mask = kind == 5
        index = variable[key[mask] - self._ranges]
        out[mask] = np.where(index >= 0, self._ranges + index, -1)
        mask = kind == 6
        product, plane = np.divmod(key[mask] - self._envelopes, 4)
        index = variable[self.products + product]
        out[mask] = np.where(index >= 0, self._envelopes + 4 * (index - self.products) + plane, -1)
        return out


def find_positions(key: IntArray, keys: IntArray) -> IntArray:
    """Return the position of each key among others, -1 where it is missing."""
    order = np.argsort(keys, kind="stable")
    position = np.minimum(np.searchsorted(keys[order], key), max(len(keys) - 1, 0))
    if not len(keys):
        return np.full(len(key), -1)
    match = order[position]
    return np.where((keys[match] == key) & (key >= 0), match, -1)
