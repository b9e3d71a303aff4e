"""Compiled functions that only others call are made machine code with these, not by themselves.

Numba optimises each function together with all that it calls, and makes machine code of that, at
every level anew: a function ten calls deep is optimised and generated ten times. Functions that
Python cannot call need neither. Here they stay in LLVM's intermediate code until one that Python
can call takes them in, and is optimised once as a whole.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import compiler, typed_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment

_dynfunc: Any = numba._dynfunc


class _Joined(JITCodeLibrary):  # type: ignore[misc]  # Numba has no types
    """Code of a function, and of those that it calls, as it was written."""

    def _optimize_functions(self, module: Any) -> None:
        # Enough to be small; the rest is done once all is together
        level = numba.config.OPT
        try:
            numba.config.OPT = type(level)(min(level, 1))
            super()._optimize_functions(module)
        finally:
            numba.config.OPT = level

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            # Older versions of Numba have none
            if hasattr(self, "_reload_init"):
                self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        return tuple(self.serialize_using_bitcode())


@register_pass(mutates_CFG=True, analysis_only=False)
class _Inner(typed_passes.NativeLowering):  # type: ignore[misc]
    """Code for other compiled functions alone."""

    _name = "climbplan_inner"

    def run_pass(self, state: Any) -> bool:
        context, codegen = state.targetctx, state.targetctx.codegen()
        state.library = _Joined(codegen, state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        # What Numba knows the function by; it has no address
        name = lowered.fndesc.qualname.split(".")[-1]
        place = lowered.fndesc.lookup_module()
        known_by = _dynfunc.make_function(place, name, "", 0, lowered.env, (state.library,))
        context.insert_user_function(known_by, lowered.fndesc, [state.library])
        if hasattr(state.library, "_reload_init"):
            state.reload_init.extend(state.library._reload_init)
        state["cr"] = lowered._replace(cfunc=known_by)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Outer(typed_passes.NativeLowering):  # type: ignore[misc]
    """Code that Python calls: constants that functions keep are given to all that it took in."""

    _name = "climbplan_outer"

    def run_pass(self, state: Any) -> bool:
        super().run_pass(state)
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                state.library.codegen.set_env(variable.name, environment)
        return True


def _with(lowering: type[Any]) -> type[Any]:
    class Pipeline(compiler.CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [
                (lowering if p is typed_passes.NativeLowering else p, word)
                for p, word in passes.passes
            ]
            passes.finalize()
            return [passes]

    return Pipeline


INNER, OUTER = _with(_Inner), _with(_Outer)
