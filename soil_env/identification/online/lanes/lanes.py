"""Lanes: eight float64 numbers as one value inside compiled code.

Eight numbers are one AVX-512 register (two of AVX2, four of SSE2 or NEON: LLVM splits them). They
are eight wheels that are stepped at once, or the eight quadrature nodes of one wheel's contact arc.
`elementary` has the functions on them. A law that is written for "floats or lanes" is compiled for
either. With NUMBA_DISABLE_JIT=1 lanes are arrays of eight numbers (`interpreted`).
"""

import operator

from llvmlite import ir
from numba import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model
from numba.np.arrayobj import make_array, populate_array

from soil_env.identification.online.lanes import interpreted
from soil_env.identification.online.lanes.compiling import COMPILED
from soil_env.identification.online.lanes.pipeline import remember_types

COUNT = 8


class Lanes(types.Type):
    """Numba type of eight float64."""

    def __init__(self) -> None:
        super().__init__(name="float64x8")


lanes = Lanes()
VECTOR = ir.VectorType(ir.DoubleType(), COUNT)
INTEGERS = ir.VectorType(ir.IntType(64), COUNT)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, VECTOR)


def spread(builder, value):
    """Code for `value` in every lane."""
    one = builder.insert_element(
        ir.Constant(VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    mask = ir.Constant(ir.VectorType(ir.IntType(32), COUNT), [0] * COUNT)
    return builder.shuffle_vector(one, ir.Constant(VECTOR, ir.Undefined), mask)


def numbers(*values):
    """Code for eight constant lanes."""
    return ir.Constant(VECTOR, [float(v) for v in values])


def emitted(definition):
    """Decorate an `intrinsic` of numba; where nothing is compiled it is the function of that name
    in `interpreted`.
    """
    return intrinsic(definition) if COMPILED else getattr(interpreted, definition.__name__)


_PAIRS = [
    signature(lanes, lanes, lanes),
    signature(lanes, lanes, types.float64),
    signature(lanes, types.float64, lanes),
]


def _operator(op, emit, signatures):
    class Template(ConcreteTemplate):
        cases = signatures

    infer_global(op)(Template)
    for case in signatures:

        @lower_builtin(op, *case.args)
        def lower(context, builder, sig, args):
            return emit(
                builder,
                *(
                    a if t == lanes else spread(builder, a)
                    for a, t in zip(args, sig.args, strict=True)
                ),
            )


def call(builder, name, args):
    """Code for a call of an LLVM intrinsic, whose arguments and result have one type."""
    function_type = ir.FunctionType(args[0].type, [a.type for a in args])
    try:
        function = builder.module.get_global(name)
    except KeyError:
        function = ir.Function(builder.module, function_type, name)
    return builder.call(function, args)


_operator(operator.add, lambda b, x, y: b.fadd(x, y), _PAIRS)
_operator(operator.sub, lambda b, x, y: b.fsub(x, y), _PAIRS)
_operator(operator.mul, lambda b, x, y: b.fmul(x, y), _PAIRS)
_operator(operator.truediv, lambda b, x, y: b.fdiv(x, y), _PAIRS)
_operator(operator.neg, lambda b, x: b.fneg(x), [signature(lanes, lanes)])
_operator(abs, lambda b, x: call(b, "llvm.fabs.v8f64", [x]), [signature(lanes, lanes)])
if COMPILED:
    remember_types()


@emitted
def fill(typingctx, x):
    """`x` in every lane."""
    if x == lanes:
        return lanes(lanes), lambda context, builder, sig, args: args[0]
    return lanes(types.float64), lambda context, builder, sig, args: spread(builder, args[0])


@emitted
def alike(typingctx, x, pattern):
    """The float `x` as what `pattern` is: a float, or lanes."""
    if pattern == lanes:
        return lanes(types.float64, lanes), lambda context, builder, sig, args: spread(
            builder, args[0]
        )
    return types.float64(types.float64, types.float64), lambda context, builder, sig, args: args[0]


@emitted
def from_array(typingctx, a, i):
    """Lanes a[i] .. a[i + 7] of a contiguous float64 array."""

    def emit(context, builder, sig, args):
        data = make_array(sig.args[0])(context, builder, args[0]).data
        at = builder.bitcast(builder.gep(data, [args[1]]), VECTOR.as_pointer())
        value = builder.load(at)
        value.align = 8
        return value

    return lanes(a, types.intp), emit


@emitted
def to_array(typingctx, x, a, i):
    """Store lanes into a[i] .. a[i + 7] of a contiguous float64 array."""

    def emit(context, builder, sig, args):
        data = make_array(sig.args[1])(context, builder, args[1]).data
        at = builder.bitcast(builder.gep(data, [args[2]]), VECTOR.as_pointer())
        builder.store(args[0], at).align = 8
        return context.get_dummy_value()

    return types.void(lanes, a, types.intp), emit


def on_stack(builder, of, size):
    """Code for memory of the function that is compiled; unlike `cgutils.alloca_once` it does not
    fill it with zeros.
    """
    with builder.goto_entry_block():
        data = builder.alloca(ir.ArrayType(of, size))
    data.align = 64
    return data


def scratch(size):
    """A compiled function without arguments that returns a float64 array [size] on the stack of its
    caller.

    It is not set to anything, and gone when the caller returns, also where that is put into its own
    caller: the caller must not return it.
    """

    @intrinsic
    def get(typingctx):
        array_type = types.Array(types.float64, 1, "C")

        def emit(context, builder, sig, args):
            data = on_stack(builder, ir.DoubleType(), size)
            array = make_array(array_type)(context, builder)
            count = ir.Constant(ir.IntType(64), size)
            item = ir.Constant(ir.IntType(64), 8)
            pointer = builder.bitcast(data, ir.DoubleType().as_pointer())
            populate_array(
                array, data=pointer, shape=[count], strides=[item], itemsize=item, meminfo=None
            )
            return array._getvalue()

        return array_type(), emit

    return get if COMPILED else lambda: interpreted.scratch(size)


def over_eight(values):
    """A compiled function get(pattern, k): the eight numbers as lanes if `pattern` is a float,
    number k if it is lanes.

    So one loop serves one arc with its nodes in the lanes and eight arcs with one node after the
    other (`turns`, `summed`).
    """
    eight = tuple(float(v) for v in values)

    @intrinsic
    def get(typingctx, pattern, k):
        if pattern != lanes:
            return lanes(types.float64, types.intp), lambda context, builder, sig, args: numbers(
                *eight
            )

        def emit(context, builder, sig, args):
            table = ir.Constant(ir.ArrayType(ir.DoubleType(), COUNT), list(eight))
            name = f"eight_{abs(hash(eight))}"
            try:
                stored = builder.module.get_global(name)
            except KeyError:
                stored = ir.GlobalVariable(builder.module, table.type, name)
                stored.initializer = table
                stored.global_constant = True
                stored.linkage = "internal"
            zero = ir.Constant(ir.IntType(64), 0)
            return builder.load(builder.gep(stored, [zero, args[1]]))

        return types.float64(lanes, types.intp), emit

    return get if COMPILED else lambda pattern, k: interpreted.over_eight(eight, pattern, k)


@emitted
def turns(typingctx, pattern):
    """Number of passes of the loop of `over_eight`: one for a float, eight for lanes."""
    count = COUNT if pattern == lanes else 1
    pattern = lanes if pattern == lanes else types.float64
    return types.intp(pattern), lambda context, builder, sig, args: ir.Constant(
        ir.IntType(64), count
    )


@emitted
def summed(typingctx, x, pattern):
    """The sum over the eight of a value accumulated in such a loop: over the lanes of `x` if
    `pattern` is a float.
    """
    if pattern == lanes:
        return lanes(lanes, lanes), lambda context, builder, sig, args: args[0]
    return types.float64(lanes, types.float64), lambda context, builder, sig, args: _total(
        builder, args[0]
    )


def _shuffled(builder, a, b, order):
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), list(order))
    return builder.shuffle_vector(a, b, mask)


def _total(builder, value):
    for half in (4, 2, 1):
        n = 2 * half
        low = _shuffled(builder, value, value, range(half))
        high = _shuffled(builder, value, value, range(half, n))
        value = builder.fadd(low, high)
    return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))


@emitted
def total(typingctx, a):
    """The sum over the lanes."""

    return types.float64(lanes), lambda context, builder, sig, args: _total(builder, args[0])


@emitted
def smallest(typingctx, a):
    """The smallest of the lanes."""

    def emit(context, builder, sig, args):
        value = args[0]
        for half in (4, 2, 1):
            low = _shuffled(builder, value, value, range(half))
            high = _shuffled(builder, value, value, range(half, 2 * half))
            value = builder.select(builder.fcmp_ordered("<", low, high), low, high)
        return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))

    return types.float64(lanes), emit
