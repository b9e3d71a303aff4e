"""Generate machine code from CasADi functions inside of code that Numba compiles.

A statement in CasADi's scalars is differentiated by CasADi. Its instructions are translated one by
one to LLVM where a compiled function calls it. That needs neither CasADi's interpreter at run time
nor a C compiler, and no source text is written or executed. Arithmetic is IEEE in CasADi's order.
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


def create_kernel(declare: Callable[[], Any]) -> Kernel:
    """Create a function f(inputs, outputs) of a CasADi function that compiled functions can call.

    `inputs` is a tuple of numbers (for scalars) or C-ordered arrays of floats. `outputs` is a tuple
    of such arrays, which are written, zeros of sparse matrices included, and must not overlap the
    inputs. Arrays are read and written in memory order, while CasADi's is by columns: a matrix (m,
    n) there is an array (n, m) here.

    The compiled caller raises ValueError where an array has the wrong number of entries.
    Unsupported functions are a Numba error when the caller is compiled.

    Args:
        declare: Returns the `ca.Function` of `ca.SX` with dense inputs; called only for
            compilation.
    """
    declared = cache(declare)

    def evaluate(typing: Any, inputs: Any, outputs: Any) -> Any:
        _check_signature(declared(), inputs, outputs)

        def lower_function(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            _Lowering(context, builder, declared()).write(signature.args, args)
            return context.get_dummy_value()

        return types.void(inputs, outputs), lower_function

    compiled_kernel: Kernel = intrinsic(evaluate)
    return compiled_kernel


def hash_sources(*modules: ModuleType) -> bytes:
    """Return a hash of everything on which code generated from these modules depends."""
    digest = hashlib.sha256(ca.CasadiMeta.version().encode())
    for source in (__file__, *(module.__file__ for module in modules)):
        digest.update(Path(str(source)).read_bytes())
    return digest.digest()


def _check_signature(function: Any, inputs: Any, outputs: Any) -> None:
    """Raise TypingError unless the argument types fit a function that can be generated."""
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
    for k, kind in enumerate(inputs):
        if not function.sparsity_in(k).is_dense():
            raise TypingError(f"{name}: input {k} is sparse")
        number = isinstance(kind, types.Float | types.Integer) and function.numel_in(k) == 1
        if not (number or _is_float_array(kind)):
            raise TypingError(f"{name}: input {k} is {kind}, not a C-ordered array of floats")
    for k, kind in enumerate(outputs):
        if not (_is_float_array(kind) and kind.mutable):
            raise TypingError(f"{name}: output {k} is {kind}, not a C-ordered array of floats")
    operations = {function.instruction_id(k) for k in range(function.n_instructions())}
    if unknown := operations - _OTHERS - set(_ARITHMETIC) - set(_CALLS):
        names = [
            operation
            for operation in dir(ca)
            if operation[:3] == "OP_" and getattr(ca, operation) in unknown
        ]
        raise TypingError(f"{name}: no code is generated for CasADi's {', '.join(names)}")


def _is_float_array(kind: Any) -> bool:
    """Return whether a type is a C-ordered array of float64."""
    array = isinstance(kind, types.Array) and kind.layout == "C" and kind.aligned
    return array and kind.dtype == types.float64


class _Lowering:
    """Emits a CasADi function's instructions at the position of Numba's builder."""

    def __init__(self, context: Any, builder: Any, function: Any) -> None:
        self.context, self.builder, self.function = context, builder, function

    def write(self, argument_types: Any, args: Any) -> None:
        """Emit all instructions, for a tuple of inputs and one of outputs."""
        function = self.function
        inputs = self._unpack(argument_types[0], args[0], function.numel_in)
        outputs = self._unpack(argument_types[1], args[1], function.numel_out)
        entries = [self._write_zeros(k, outputs[k]) for k in range(function.n_out())]
        work: dict[int, Any] = {}  # values in CasADi's work vector, whose entries are reused
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            sources, targets = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                output_index, nonzero = targets
                self.builder.store(
                    work[sources[0]],
                    self._emit_pointer(outputs[output_index], entries[output_index][nonzero]),
                )
            elif operation == ca.OP_INPUT:
                work[targets[0]] = self._load(inputs[sources[0]], sources[1])
            elif operation == ca.OP_CONST:
                work[targets[0]] = self._emit_constant(function.instruction_constant(k))
            else:
                work[targets[0]] = self._emit_operation(operation, [work[i] for i in sources])

    def _unpack(self, kind: Any, packed: Any, counts: Callable[[int], int]) -> list[Any]:
        """Return entries of a tuple: numbers, and data pointers of arrays whose size is checked."""
        values = cgutils.unpack_tuple(self.builder, packed)
        unpacked = []
        for k, (entry_type, value) in enumerate(zip(kind, values, strict=True)):
            if not isinstance(entry_type, types.Array):
                number = self.context.cast(self.builder, value, entry_type, types.float64)
                unpacked.append(number)
                continue
            array = self.context.make_array(entry_type)(self.context, self.builder, value)
            count = self.context.get_constant(types.intp, counts(k))
            is_wrong_size = self.builder.icmp_signed("!=", array.nitems, count)
            with self.builder.if_then(is_wrong_size, likely=False):
                message = f"{self.function.name()}: an array of {counts(k)} numbers was expected"
                self.context.call_conv.return_user_exc(self.builder, ValueError, (message,))
            unpacked.append(array.data)
        return unpacked

    def _write_zeros(self, output_index: int, data: Any) -> list[int]:
        """Return the position of each nonzero in an output; set all other entries to zero."""
        pattern = self.function.sparsity_out(output_index)
        rows, columns = pattern.get_triplet()
        height = pattern.size1()
        entries = [row + height * column for row, column in zip(rows, columns, strict=True)]
        for entry in sorted(set(range(pattern.numel())) - set(entries)):
            self.builder.store(self._emit_constant(0.0), self._emit_pointer(data, entry))
        return entries

    def _load(self, value: Any, entry: int) -> Any:
        """Load an entry of an input."""
        return (
            self.builder.load(self._emit_pointer(value, entry)) if value.type.is_pointer else value
        )

    def _emit_operation(self, operation: int, values: list[Any]) -> Any:
        """Emit one arithmetic operation."""
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
            return builder.fdiv(self._emit_constant(1.0), values[0])
        real = types.float64
        call = self.context.get_function(_CALLS[operation], real(*[real] * len(values)))
        return call(builder, values)

    def _emit_constant(self, value: float) -> Any:
        """Emit a constant."""
        return self.context.get_constant(types.float64, value)

    def _emit_pointer(self, data: Any, entry: int) -> Any:
        """Emit the pointer to an entry."""
        return cgutils.gep_inbounds(self.builder, data, entry)
