"""Passes of numba's compiler that the functions of this package need, and no others.

Numba's own pipeline has 27 passes, most of which look for what no kernel here has (closures, object mode, array
expressions, parallel loops), and LLVM optimises every function of a tree twice. Here a part runs eight passes and is
linked as it is; the root of the tree is optimised once. Python's garbage collector, which would walk through numba's
many small objects again and again and find nothing, waits until a root is done.
"""

import gc
import operator
from contextlib import contextmanager

from llvmlite.binding import create_new_module_pass_manager as new_module_passes
from numba import types
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import cpu_target
from numba.extending import models, register_model


class _WithoutEnvironment:
    """The code generator, for functions that have no place in memory into which Python objects could be written."""

    def __init__(self, codegen) -> None:
        self._codegen = codegen

    def __getattr__(self, name):
        return getattr(self._codegen, name)

    def set_env(self, name, environment):
        pass


class _Part(JITCodeLibrary):
    """Code that is only ever linked into that of a caller: neither optimised nor turned into machine code by itself."""

    linkable = False  # while a root is linked; any other caller would miss what this part calls

    @property
    def codegen(self):
        return _WithoutEnvironment(self._codegen)

    def get_pointer_to_function(self, name):
        return 0

    def _optimize_functions(self, module):
        """Values out of memory, into registers; the rest is the root's."""
        module.data_layout = self._codegen._data_layout
        passes = new_module_passes()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.run(module, self._codegen._pass_builder(opt=1))

    def _get_module_for_linking(self):
        if not _Part.linkable:
            raise TypeError(
                f"{self.name}: a part called by a function of numba's `njit`: make that a `compiled_root`"
            )
        return super()._get_module_for_linking()

    def finalize(self):
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalize_dynamic_globals()
        self._finalized = True


class _Root(JITCodeLibrary):
    """Code with all parts below it, each linked once."""

    def add_linking_library(self, library):
        super().add_linking_library(library)
        for below in library._linking_libraries:
            if below not in self._linking_libraries:
                self.add_linking_library(below)

    def finalize(self):
        _Part.linkable = True
        try:
            super().finalize()
        finally:
            _Part.linkable = False


class _Passes:
    """The passes of numba over a function without closures, `with`, generators and counted references."""

    pipeline_name = "soil_env"
    passes = tuple(
        kind()
        for kind in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            untyped_passes.IRProcessing,
            untyped_passes.GenericRewrites,
            untyped_passes.ReconstructSSA,
            typed_passes.NopythonTypeInference,
            typed_passes.PreLowerStripPhis,
            typed_passes.NativeLowering,
            typed_passes.NoPythonBackend,
        )
    )

    def __init__(self) -> None:
        self.exec_times = {}

    def run(self, state):
        """Run the passes on the state of numba's compiler."""
        for step in self.passes:
            step.run_pass(state)


@contextmanager
def _uncollected():
    """No garbage collection meanwhile."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


class _Remembered(types.Function):
    """A built-in function whose type of result is found once for given types of arguments.

    Numba tries all templates of the function, and formats an error for each that does not fit, at every occurrence.
    """

    def __init__(self, templates) -> None:
        super().__init__(templates)
        self._signatures = {}

    def augment(self, other):
        """With the templates of `other`, as numba's own: another library registers more of them."""
        return types.Function(self.templates).augment(other)

    def get_call_type(self, context, args, kws):
        key = (tuple(args), tuple(kws.items()))
        if key not in self._signatures:
            self._signatures[key] = super().get_call_type(context, args, kws)
        return self._signatures[key]


register_model(_Remembered)(models.OpaqueModel)


def remember_types() -> None:
    """Let numba remember the types of operators, and try its built-in ones before overloads."""
    context = cpu_target.typing_context
    context.refresh()
    for name in (
        "getitem",
        "setitem",
        "add",
        "sub",
        "mul",
        "truediv",
        "eq",
        "ne",
        "lt",
        "le",
        "gt",
        "ge",
    ):
        op = getattr(operator, name)
        templates = context._lookup_global(op).templates
        context._remove_global(op)
        context._insert_global(
            op, _Remembered(sorted(templates, key=lambda t: t.__name__.startswith("Overload")))
        )


def _compiler(library_class, default):
    class Pipeline(Compiler):
        def compile_extra(self, func):
            codegen = self.state.targetctx.codegen()
            self.state.library = library_class(codegen, func.__qualname__)
            self.state.library.enable_object_caching()
            if library_class is _Part:
                return super().compile_extra(func)
            with _uncollected():
                return super().compile_extra(func)

        def define_pipelines(self):
            return super().define_pipelines() if default else [_Passes()]

    return Pipeline


#: Numba's compiler for parts, for roots, and for roots that may make arrays.
PART = _compiler(_Part, False)
ROOT = _compiler(_Root, False)
ALLOCATING = _compiler(_Root, True)
