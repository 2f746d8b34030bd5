"""numpy's own inner loops, callable from compiled code.

highway-env computes with numpy, whose `power`, `tan`, `arcsin` and `dot` give other last bits on other CPUs (AVX-512
kernels, fused multiply-add). The kernel therefore calls the very functions that numpy would call here: equal by
construction, wherever it runs. They also take whole arrays, many elements at a time. These functions run compiled only.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

POWER, TAN, ARCTAN, ARCSIN, SIN, COS, DOT = range(7)


class _Ufunc(ctypes.Structure):
    """The documented head of numpy's PyUFuncObject."""

    _fields_ = [
        ("head", ctypes.c_byte * object.__basicsize__), ("nin", ctypes.c_int), ("nout", ctypes.c_int),
        ("nargs", ctypes.c_int), ("identity", ctypes.c_int), ("functions", ctypes.POINTER(ctypes.c_void_p)),
        ("data", ctypes.POINTER(ctypes.c_void_p)), ("ntypes", ctypes.c_int),
    ]  # fmt: skip


def _loop(ufunc: np.ufunc, signature: str) -> tuple[int, int]:
    head = _Ufunc.from_address(id(ufunc))
    if (head.nin, head.nout, head.ntypes) != (ufunc.nin, ufunc.nout, len(ufunc.types)):
        raise RuntimeError(f"numpy {np.__version__} lays out its ufuncs in a way that this version does not know")
    k = ufunc.types.index(signature)
    return head.functions[k] or 0, (head.data[k] or 0) if head.data else 0


def addresses() -> NDArray[np.int64]:
    """(7, 2) function and data address of each loop, in the order of the constants above; good for this process."""
    unary = (np.tan, np.arctan, np.arcsin, np.sin, np.cos)
    found = [_loop(np.power, "dd->d"), *(_loop(u, "d->d") for u in unary), _loop(np.vecdot, "dd->d")]
    return np.array(found, np.uint64).astype(np.int64)


@intrinsic  # type: ignore[untyped-decorator]
def _call(typing_context: Any, function: Any, args: Any, dims: Any, steps: Any, data: Any) -> Any:
    """Call a PyUFuncGenericFunction; all five are addresses."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        target = builder.inttoptr(values[0], kind.as_pointer())
        builder.call(target, [builder.inttoptr(value, pointer) for value in values[1:]])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 5), generate


def unary(loops: Any, which: int, args: Any, x: Any, out: Any, n: int) -> None:
    """out[:n] = f(x[:n]); contiguous float64; args: (16,) int64 of scratch."""
    if n == 0:
        return
    args[0], args[1] = x.ctypes.data, out.ctypes.data
    args[3], args[4], args[5] = n, 8, 8
    base = args.ctypes.data
    _call(loops[which, 0], base, base + 24, base + 32, loops[which, 1])


def power(loops: Any, args: Any, x: Any, exponent: Any, out: Any, n: int) -> None:
    """out[:n] = x[:n] ** exponent[:n], as np.power."""
    args[0], args[1], args[2] = x.ctypes.data, exponent.ctypes.data, out.ctypes.data
    args[3], args[4], args[5], args[6] = n, 8, 8, 8
    base = args.ctypes.data
    _call(loops[POWER, 0], base, base + 24, base + 32, loops[POWER, 1])


def dot(loops: Any, args: Any, box: Any, ax: float, ay: float, bx: float, by: float) -> float:
    """np.dot of two plane vectors; box: (5,) float64 of scratch."""
    p, q = ax * bx, ay * by
    if p == 0.0 or q == 0.0:  # exact with and without a fused multiply-add
        return p + q
    box[0], box[1], box[2], box[3] = ax, ay, bx, by
    base, values = args.ctypes.data, box.ctypes.data
    args[0], args[1], args[2] = values, values + 16, values + 32
    args[3], args[4] = 1, 2
    args[5], args[6], args[7], args[8], args[9] = 16, 16, 8, 8, 8
    _call(loops[DOT, 0], base, base + 24, base + 40, loops[DOT, 1])
    return float(box[4])


def one(loops: Any, which: int, args: Any, box: Any, x: float) -> float:
    """f(x) of a single number."""
    if x == 0.0 and which != COS:  # exact, and the most frequent case
        return x
    box[0] = x
    unary(loops, which, args, box, box[1:], 1)
    return float(box[1])
