"""Vectors of WIDTH float32 values, one register of the machine: a kernel states which values stay in registers.

Matrices must be C-contiguous and float32 (other types do not compile), and the columns ``column`` to ``column + WIDTH``
must exist.
"""

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

_FEATURES = binding.get_host_cpu_features()
# Values per register: 16 with AVX-512, 8 with AVX2, 4 with SSE or NEON. A divisor of tiling.SIMD_WIDTH.
WIDTH = 16 if _FEATURES.get("avx512f") else 8 if _FEATURES.get("avx2") else 4

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, WIDTH)
_ALIGNED = 4  # bytes: a row may begin at any float
_FAST = ("fast",)  # a product and a sum may be fused into one instruction


class _Vector(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"float32x{WIDTH}")


_vector = _Vector()


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR)


def _address(context, builder, array_type, array, row, column):
    matrix = context.make_array(array_type)(context, builder, array)
    offset = builder.add(builder.mul(row, builder.extract_value(matrix.shape, 1)), column)
    return builder.bitcast(builder.gep(matrix.data, [offset]), _VECTOR.as_pointer())


def _is_matrix(array) -> bool:
    return isinstance(array, types.Array) and (array.dtype, array.ndim, array.layout) == (types.float32, 2, "C")


@intrinsic
def zeros(typing):
    """Return a vector of zeros."""
    return _vector(), lambda context, builder, signature, args: ir.Constant(_VECTOR, [0.0] * WIDTH)


@intrinsic
def load(typing, array, row, column):
    """Return ``array[row, column : column + WIDTH]``."""

    def code(context, builder, signature, args):
        return builder.load(_address(context, builder, array, *args), align=_ALIGNED)

    return (_vector(array, types.intp, types.intp), code) if _is_matrix(array) else None


@intrinsic
def store(typing, array, row, column, value):
    """Set ``array[row, column : column + WIDTH] = value``."""

    def code(context, builder, signature, args):
        builder.store(args[3], _address(context, builder, array, *args[:3]), align=_ALIGNED)
        return context.get_dummy_value()

    return (types.void(array, types.intp, types.intp, _vector), code) if _is_matrix(array) else None


@intrinsic
def multiply_add(typing, factor, vector, total):
    """Return ``factor * vector + total`` for a scalar factor."""

    def code(context, builder, signature, args):
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.insert_element(undefined, args[0], ir.Constant(_INDEX, 0))
        zero_mask = ir.Constant(ir.VectorType(_INDEX, WIDTH), [0] * WIDTH)
        factors = builder.shuffle_vector(first, undefined, zero_mask)
        return builder.fadd(builder.fmul(factors, args[1], flags=_FAST), args[2], flags=_FAST)

    return _vector(types.float32, _vector, _vector), code


@intrinsic
def multiply_add_vectors(typing, first, second, total):
    """Return ``first * second + total``, element by element."""

    def code(context, builder, signature, args):
        return builder.fadd(builder.fmul(args[0], args[1], flags=_FAST), args[2], flags=_FAST)

    return _vector(_vector, _vector, _vector), code


@intrinsic
def total(typing, vector):
    """Return the sum of the elements of ``vector``."""

    def code(context, builder, signature, args):
        kind = ir.FunctionType(_FLOAT, [_FLOAT, _VECTOR])
        reduction = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{WIDTH}f32")
        return builder.call(reduction, [ir.Constant(_FLOAT, 0.0), args[0]], fastmath=_FAST)

    return types.float32(_vector), code


@intrinsic
def positive(typing, vector):
    """Return the element-wise maximum of ``vector`` and 0."""

    def code(context, builder, signature, args):
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR])
        maximum = cgutils.get_or_insert_function(builder.module, kind, f"llvm.maxnum.v{WIDTH}f32")
        return builder.call(maximum, [args[0], ir.Constant(_VECTOR, [0.0] * WIDTH)], fastmath=_FAST)

    return _vector(_vector), code
