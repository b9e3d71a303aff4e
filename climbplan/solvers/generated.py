"""Machine code generated from CasADi functions: arithmetic inside of what Numba compiles.

A statement in CasADi's scalars is differentiated by CasADi; here its instructions become those of
LLVM, one for one, where a compiled function calls it. That takes neither CasADi's interpreter when
it runs nor a C compiler on the user's machine, and as no text is written, none is executed.
IEEE arithmetic in CasADi's order, as everywhere in compiled code.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numba
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

types: Any = numba.types

Kernel = Callable[[tuple[Any, ...], tuple[Any, ...]], None]

_ARITHMETIC = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_CALLS: dict[int, Callable[..., float]] = {
    ca.OP_SIN: math.sin,
    ca.OP_COS: math.cos,
    ca.OP_TAN: math.tan,
    ca.OP_ASIN: math.asin,
    ca.OP_ACOS: math.acos,
    ca.OP_ATAN: math.atan,
    ca.OP_ATAN2: math.atan2,
    ca.OP_EXP: math.exp,
    ca.OP_LOG: math.log,
    ca.OP_SQRT: math.sqrt,
    ca.OP_FABS: math.fabs,
    ca.OP_POW: math.pow,
    ca.OP_CONSTPOW: math.pow,
}
_OTHERS = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV}


def kernel(declare: Callable[[], Any]) -> Kernel:
    """A function f(inputs, outputs) that compiled functions can call, of a CasADi function.

    declare: gives that `ca.Function` of `ca.SX` with dense inputs; asked only where there is
    something to compile. inputs: a tuple of numbers (for scalars) or C-ordered arrays of floats;
    outputs: a tuple of such arrays, which are written, zeros of sparse matrices included, and must
    not overlap the inputs. Arrays are read and written in their order in memory, which is CasADi's
    column by column: a matrix (m, n) there is an array (n, m) here.

    The compiled caller raises ValueError where an array has not as many numbers as declared. What
    cannot be generated is a Numba error when the caller is compiled.
    """
    asked = cache(declare)

    def evaluate(typing: Any, inputs: Any, outputs: Any) -> Any:
        _refuse_unfit(asked(), inputs, outputs)

        def lowered(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            _Lowering(context, builder, asked()).write(signature.args, args)
            return context.get_dummy_value()

        return types.void(inputs, outputs), lowered

    called: Kernel = intrinsic(evaluate)
    return called


def generated_from(*modules: ModuleType) -> bytes:
    """What code generated from these modules' statements depends on, for `compiler`."""
    digest = hashlib.sha256(ca.CasadiMeta.version().encode())
    for source in (__file__, *(module.__file__ for module in modules)):
        digest.update(Path(str(source)).read_bytes())
    return digest.digest()


def _refuse_unfit(function: Any, inputs: Any, outputs: Any) -> None:
    """TypingError unless the types of arguments are those of a function that can be generated."""
    name = function.name()
    if not function.is_a("SXFunction"):
        raise TypingError(f"{name} is not stated in scalars (ca.SX)")
    if not (isinstance(inputs, types.BaseTuple) and isinstance(outputs, types.BaseTuple)):
        raise TypingError(f"{name}: inputs and outputs are tuples")
    if (len(inputs), len(outputs)) != (function.n_in(), function.n_out()):
        raise TypingError(
            f"{name} has {function.n_in()} inputs and {function.n_out()} outputs, "
            f"got {len(inputs)} and {len(outputs)}"
        )
    for k, given in enumerate(inputs):
        if not function.sparsity_in(k).is_dense():
            raise TypingError(f"{name}: input {k} is sparse")
        number = isinstance(given, types.Float | types.Integer) and function.numel_in(k) == 1
        if not (number or _is_plain(given)):
            raise TypingError(f"{name}: input {k} is {given}, not a C-ordered array of floats")
    for k, given in enumerate(outputs):
        if not (_is_plain(given) and given.mutable):
            raise TypingError(f"{name}: output {k} is {given}, not a C-ordered array of floats")
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    if unknown := used - _OTHERS - set(_ARITHMETIC) - set(_CALLS):
        names = [each for each in dir(ca) if each[:3] == "OP_" and getattr(ca, each) in unknown]
        raise TypingError(f"{name}: no code is generated for CasADi's {', '.join(names)}")


def _is_plain(given: Any) -> bool:
    """An array of float64 without gaps."""
    array = isinstance(given, types.Array) and given.layout == "C" and given.aligned
    return array and given.dtype == types.float64


class _Lowering:
    """Writes a CasADi function's instructions where Numba's builder stands."""

    def __init__(self, context: Any, builder: Any, function: Any) -> None:
        self.context, self.builder, self.function = context, builder, function

    def write(self, argument_types: Any, args: Any) -> None:
        """All of them, for a tuple of inputs and one of outputs."""
        function = self.function
        inputs = self._unpacked(argument_types[0], args[0], function.numel_in)
        outputs = self._unpacked(argument_types[1], args[1], function.numel_out)
        entries = [self._zeros_written(k, outputs[k]) for k in range(function.n_out())]
        held: dict[int, Any] = {}  # values in CasADi's work vector, whose places serve again
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            taken, given = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                place, nonzero = given
                self.builder.store(
                    held[taken[0]], self._at(outputs[place], entries[place][nonzero])
                )
            elif operation == ca.OP_INPUT:
                held[given[0]] = self._loaded(inputs[taken[0]], taken[1])
            elif operation == ca.OP_CONST:
                held[given[0]] = self._number(function.instruction_constant(k))
            else:
                held[given[0]] = self._result(operation, [held[i] for i in taken])

    def _unpacked(self, kind: Any, packed: Any, counts: Callable[[int], int]) -> list[Any]:
        """Entries of a tuple: numbers, and where data of arrays are once their count is right."""
        values = cgutils.unpack_tuple(self.builder, packed)
        unpacked = []
        for k, (each, value) in enumerate(zip(kind, values, strict=True)):
            if not isinstance(each, types.Array):
                number = self.context.cast(self.builder, value, each, types.float64)
                unpacked.append(number)
                continue
            array = self.context.make_array(each)(self.context, self.builder, value)
            count = self.context.get_constant(types.intp, counts(k))
            other = self.builder.icmp_signed("!=", array.nitems, count)
            with self.builder.if_then(other, likely=False):
                message = f"{self.function.name()}: an array of {counts(k)} numbers was expected"
                self.context.call_conv.return_user_exc(self.builder, ValueError, (message,))
            unpacked.append(array.data)
        return unpacked

    def _zeros_written(self, place: int, data: Any) -> list[int]:
        """Where in an output its nonzeros go; everything else is set to zero."""
        pattern = self.function.sparsity_out(place)
        rows, columns = pattern.get_triplet()
        height = pattern.size1()
        entries = [row + height * column for row, column in zip(rows, columns, strict=True)]
        for entry in sorted(set(range(pattern.numel())) - set(entries)):
            self.builder.store(self._number(0.0), self._at(data, entry))
        return entries

    def _loaded(self, held: Any, entry: int) -> Any:
        return self.builder.load(self._at(held, entry)) if held.type.is_pointer else held

    def _result(self, operation: int, values: list[Any]) -> Any:
        builder = self.builder
        if operation in _ARITHMETIC:
            return getattr(builder, _ARITHMETIC[operation])(*values)
        if operation == ca.OP_NEG:
            return builder.fneg(*values)
        if operation == ca.OP_SQ:
            return builder.fmul(values[0], values[0])
        if operation == ca.OP_TWICE:
            return builder.fadd(values[0], values[0])
        if operation == ca.OP_INV:
            return builder.fdiv(self._number(1.0), values[0])
        real = types.float64
        call = self.context.get_function(_CALLS[operation], real(*[real] * len(values)))
        return call(builder, values)

    def _number(self, value: float) -> Any:
        return self.context.get_constant(types.float64, value)

    def _at(self, data: Any, entry: int) -> Any:
        return cgutils.gep_inbounds(self.builder, data, entry)
