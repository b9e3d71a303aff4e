"""Numba pipelines that compile functions together with their compiled callers only.

Numba optimises each function together with everything that it calls, and generates machine code at
every level: a function ten calls deep is optimised and generated ten times. Functions that Python
cannot call do not need that. Here they stay in LLVM's intermediate representation until a function
that Python can call links them, and are optimised once as a whole.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import compiler, typed_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.environment import lookup_environment

_dynfunc: Any = numba._dynfunc


class _LinkedLibrary(JITCodeLibrary):  # type: ignore[misc]  # Numba has no types
    """Code of a function and of those that it calls, as generated."""

    def _optimize_functions(self, module: Any) -> None:
        # A low level to keep the code small; the linked code is optimised as a whole
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
class _InnerLowering(typed_passes.NativeLowering):  # type: ignore[misc]
    """Lowering of functions that only compiled functions call."""

    _name = "climbplan_inner"

    def run_pass(self, state: Any) -> bool:
        context, codegen = state.targetctx, state.targetctx.codegen()
        state.library = _LinkedLibrary(codegen, state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        # A function object by which Numba finds the code; it has no address
        name = lowered.fndesc.qualname.split(".")[-1]
        place = lowered.fndesc.lookup_module()
        known_by = _dynfunc.make_function(place, name, "", 0, lowered.env, (state.library,))
        context.insert_user_function(known_by, lowered.fndesc, [state.library])
        if hasattr(state.library, "_reload_init"):
            state.reload_init.extend(state.library._reload_init)
        state["cr"] = lowered._replace(cfunc=known_by)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _OuterLowering(typed_passes.NativeLowering):  # type: ignore[misc]
    """Lowering of functions that Python calls: constants are set in all linked functions."""

    _name = "climbplan_outer"

    def run_pass(self, state: Any) -> bool:
        super().run_pass(state)
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                state.library.codegen.set_env(variable.name, environment)
        return True


def _create_pipeline(lowering: type[Any]) -> type[Any]:
    """Create Numba's default pipeline with another lowering pass."""

    class Pipeline(compiler.CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.passes = [
                (lowering if p is typed_passes.NativeLowering else p, pass_name)
                for p, pass_name in passes.passes
            ]
            passes.finalize()
            return [passes]

    return Pipeline


INNER, OUTER = _create_pipeline(_InnerLowering), _create_pipeline(_OuterLowering)
