"""Vectors of SIMD_WIDTH float32 values, which let a kernel state which values stay in registers.

LLVM maps a vector to the registers of the machine: one of AVX-512, two of AVX2, four of SSE or NEON. Matrices must be
C-contiguous and float32 (other types do not compile), and the columns ``column`` to ``column + SIMD_WIDTH`` must exist.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from autonerf_lab.nerf.kernels.tiling import SIMD_WIDTH

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, SIMD_WIDTH)
_ALIGNED = 4  # bytes: a row may begin at any float
_FAST = ("fast",)  # a product and a sum may be fused into one instruction


class _Vector(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"float32x{SIMD_WIDTH}")


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
    return _vector(), lambda context, builder, signature, args: ir.Constant(_VECTOR, [0.0] * SIMD_WIDTH)


@intrinsic
def load(typing, array, row, column):
    """Return ``array[row, column : column + SIMD_WIDTH]``."""

    def code(context, builder, signature, args):
        return builder.load(_address(context, builder, array, *args), align=_ALIGNED)

    return (_vector(array, types.intp, types.intp), code) if _is_matrix(array) else None


@intrinsic
def store(typing, array, row, column, value):
    """Set ``array[row, column : column + SIMD_WIDTH] = value``."""

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
        zero_mask = ir.Constant(ir.VectorType(_INDEX, SIMD_WIDTH), [0] * SIMD_WIDTH)
        factors = builder.shuffle_vector(first, undefined, zero_mask)
        return builder.fadd(builder.fmul(factors, args[1], flags=_FAST), args[2], flags=_FAST)

    return _vector(types.float32, _vector, _vector), code


@intrinsic
def positive(typing, vector):
    """Return the element-wise maximum of ``vector`` and 0."""

    def code(context, builder, signature, args):
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR])
        maximum = cgutils.get_or_insert_function(builder.module, kind, f"llvm.maxnum.v{SIMD_WIDTH}f32")
        return builder.call(maximum, [args[0], ir.Constant(_VECTOR, [0.0] * SIMD_WIDTH)], fastmath=_FAST)

    return _vector(_vector), code
