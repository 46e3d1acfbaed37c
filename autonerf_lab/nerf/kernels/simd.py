"""Vectors of LANES float32, for kernels that say what stays in registers instead of hoping that the compiler finds it.

LLVM fits them to the machine: one register of AVX-512, two of AVX2, four of SSE or NEON. Matrices are C-contiguous and
float32, another type does not compile; the LANES columns from ``column`` on have to exist.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from autonerf_lab.nerf.kernels.tiling import LANES

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_ALIGNED = 4  # bytes: a row begins anywhere
_FAST = ("fast",)  # a product and a sum may become one instruction


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"float32x{LANES}")


_lanes = _Lanes()


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR)


def _address(context, builder, array_type, array, row, column):
    matrix = context.make_array(array_type)(context, builder, array)
    place = builder.add(builder.mul(row, builder.extract_value(matrix.shape, 1)), column)
    return builder.bitcast(builder.gep(matrix.data, [place]), _VECTOR.as_pointer())


def _is_matrix(array) -> bool:
    return isinstance(array, types.Array) and (array.dtype, array.ndim, array.layout) == (types.float32, 2, "C")


@intrinsic
def zeros(typing):
    """LANES zeros."""
    return _lanes(), lambda context, builder, signature, args: ir.Constant(_VECTOR, [0.0] * LANES)


@intrinsic
def load(typing, array, row, column):
    """``array[row, column : column + LANES]``."""

    def code(context, builder, signature, args):
        return builder.load(_address(context, builder, array, *args), align=_ALIGNED)

    return (_lanes(array, types.intp, types.intp), code) if _is_matrix(array) else None


@intrinsic
def store(typing, array, row, column, value):
    """``array[row, column : column + LANES] = value``."""

    def code(context, builder, signature, args):
        builder.store(args[3], _address(context, builder, array, *args[:3]), align=_ALIGNED)
        return context.get_dummy_value()

    return (types.void(array, types.intp, types.intp, _lanes), code) if _is_matrix(array) else None


@intrinsic
def multiply_add(typing, factor, lanes, total):
    """``factor * lanes + total``; the factor is a number."""

    def code(context, builder, signature, args):
        nothing = ir.Constant(_VECTOR, ir.Undefined)
        first = builder.insert_element(nothing, args[0], ir.Constant(_INDEX, 0))
        everywhere = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
        factors = builder.shuffle_vector(first, nothing, everywhere)
        return builder.fadd(builder.fmul(factors, args[1], flags=_FAST), args[2], flags=_FAST)

    return _lanes(types.float32, _lanes, _lanes), code


@intrinsic
def positive(typing, lanes):
    """What of ``lanes`` is positive, and 0 for the rest."""

    def code(context, builder, signature, args):
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR])
        larger = cgutils.get_or_insert_function(builder.module, kind, f"llvm.maxnum.v{LANES}f32")
        return builder.call(larger, [args[0], ir.Constant(_VECTOR, [0.0] * LANES)], fastmath=_FAST)

    return _lanes(_lanes), code
