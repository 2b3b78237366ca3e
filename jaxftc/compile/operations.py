"""The table of operations: what XLA means by each, in C99 and, for constants, in NumPy.

C and XLA differ where it matters: the larger of x and NaN is NaN to XLA and x to ``fmax``; a cast of NaN or of a number out
of range to an integer is undefined in C, as is an overflow of integers. A row says what XLA says. A new operation is its
line here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class Row(NamedTuple):
    """One operation: of operands {0}, {1}, {2}; {f} is f in single precision, {of} names a type in helpers."""

    c: str
    fold: Callable[..., Any]  # the same of NumPy scalars
    swaps: bool = False  # its two operands can change places


def _saturated(dtype: Any) -> Callable[[Any], Any]:
    bounds = np.iinfo(dtype)
    return lambda x: 0 if np.isnan(x) else int(np.clip(x, bounds.min, bounds.max))


FLOATS: dict[str, Row] = {
    "add": Row("{0} + {1}", np.add, swaps=True),
    "sub": Row("{0} - {1}", np.subtract),
    "mul": Row("{0} * {1}", np.multiply, swaps=True),
    "div": Row("{0} / {1}", np.divide),
    "rem": Row("fmod{f}({0}, {1})", np.fmod),
    "neg": Row("-{0}", np.negative),
    "abs": Row("fabs{f}({0})", np.abs),
    "max": Row("ftc_max_{of}({0}, {1})", np.maximum, swaps=True),
    "min": Row("ftc_min_{of}({0}, {1})", np.minimum, swaps=True),
    "sign": Row("ftc_sign_{of}({0})", np.sign),
    "floor": Row("floor{f}({0})", np.floor),
    "ceil": Row("ceil{f}({0})", np.ceil),
    "round_even": Row("rint{f}({0})", np.rint),
    "round_away": Row("round{f}({0})", lambda x: np.sign(x) * np.floor(np.abs(x) + 0.5)),
    "sqrt": Row("sqrt{f}({0})", np.sqrt),
    "cbrt": Row("cbrt{f}({0})", np.cbrt),
    "rsqrt": Row("1 / sqrt{f}({0})", lambda x: 1 / np.sqrt(x)),
    "logistic": Row("1 / (1 + exp{f}(-{0}))", lambda x: 1 / (1 + np.exp(-x))),
    "square": Row("{0} * {0}", np.square),
    "one_minus_square": Row("1 - {0} * {0}", lambda x: 1 - x * x),
    "exp": Row("exp{f}({0})", np.exp),
    "expm1": Row("expm1{f}({0})", np.expm1),
    "log": Row("log{f}({0})", np.log),
    "log1p": Row("log1p{f}({0})", np.log1p),
    "pow": Row("pow{f}({0}, {1})", np.power),
    "sin": Row("sin{f}({0})", np.sin),
    "cos": Row("cos{f}({0})", np.cos),
    "tan": Row("tan{f}({0})", np.tan),
    "asin": Row("asin{f}({0})", np.arcsin),
    "acos": Row("acos{f}({0})", np.arccos),
    "atan": Row("atan{f}({0})", np.arctan),
    "atan2": Row("atan2{f}({0}, {1})", np.arctan2),
    "sinh": Row("sinh{f}({0})", np.sinh),
    "cosh": Row("cosh{f}({0})", np.cosh),
    "tanh": Row("tanh{f}({0})", np.tanh),
    "is_finite": Row("isfinite({0})", np.isfinite),
}
INTEGERS: dict[str, Row] = {  # they wrap, as XLA's do; a division by zero has no row
    "add": Row("({int})((u{int}){0} + (u{int}){1})", np.add, swaps=True),
    "sub": Row("({int})((u{int}){0} - (u{int}){1})", np.subtract),
    "mul": Row("({int})((u{int}){0} * (u{int}){1})", np.multiply, swaps=True),
    "neg": Row("({int})(0u - (u{int}){0})", np.negative),
    "max": Row("{0} > {1} ? {0} : {1}", np.maximum, swaps=True),
    "min": Row("{0} < {1} ? {0} : {1}", np.minimum, swaps=True),
    "sign": Row("({0} > 0) - ({0} < 0)", np.sign),
    "and": Row("{0} & {1}", np.bitwise_and, swaps=True),
    "or": Row("{0} | {1}", np.bitwise_or, swaps=True),
    "xor": Row("{0} ^ {1}", np.bitwise_xor, swaps=True),
    "not": Row("~{0}", np.invert),
}
BOOLS: dict[str, Row] = {
    "and": Row("{0} && {1}", np.logical_and, swaps=True),
    "or": Row("{0} || {1}", np.logical_or, swaps=True),
    "xor": Row("{0} != {1}", np.logical_xor, swaps=True),
    "not": Row("!{0}", np.logical_not),
    "max": Row("{0} || {1}", np.logical_or, swaps=True),
    "min": Row("{0} && {1}", np.logical_and, swaps=True),
}
ANY: dict[str, Row] = {  # of operands of any one type
    "eq": Row("{0} == {1}", np.equal, swaps=True),
    "ne": Row("{0} != {1}", np.not_equal, swaps=True),
    "lt": Row("{0} < {1}", np.less),
    "le": Row("{0} <= {1}", np.less_equal),
    "gt": Row("{0} > {1}", np.greater),
    "ge": Row("{0} >= {1}", np.greater_equal),
    "select": Row("{0} ? {1} : {2}", lambda which, yes, no: yes if which else no),
    "to_float32": Row("(float){0}", np.float32),
    "to_float64": Row("(double){0}", np.float64),
    "to_int32": Row("(int32_t){0}", np.int32),
    "to_int64": Row("(int64_t){0}", np.int64),
    "to_bool": Row("{0} != 0", np.bool_),
    "saturate_int32": Row("ftc_int32({0})", _saturated(np.int32)),  # of a float
    "saturate_int64": Row("ftc_int64({0})", _saturated(np.int64)),
}
TYPES = {"float32": "float", "float64": "double", "int32": "int32_t", "int64": "int64_t", "bool": "bool"}  # in C
HELPERS: dict[str, str] = {
    "max": "static inline {t} ftc_max_{t}({t} a, {t} b) {{ return a > b || a != a ? a : b; }} /* NaN stays */",
    "min": "static inline {t} ftc_min_{t}({t} a, {t} b) {{ return a < b || a != a ? a : b; }}",
    "sign": "static inline {t} ftc_sign_{t}({t} a) {{ return a > 0 ? 1 : a < 0 ? -1 : a; }}",
    "saturate_int32": "static inline int32_t ftc_int32(double a) {{ return a >= INT32_MAX ? INT32_MAX : a <= INT32_MIN ? "
    "INT32_MIN : a != a ? 0 : (int32_t)a; }}",
    "saturate_int64": "static inline int64_t ftc_int64(double a) {{ return a >= 0x1p63 ? INT64_MAX : a <= -0x1p63 ? "
    "INT64_MIN : a != a ? 0 : (int64_t)a; }}",
}


def row(name: str, dtype: np.dtype) -> Row:
    """The row of an operation on operands of a type.

    Raises:
        ValueError: C code is not written for it.
    """
    own = {"f": FLOATS, "i": INTEGERS, "b": BOOLS}.get(dtype.kind, {})
    found = own.get(name) or ANY.get(name)
    if found is None or dtype.name not in TYPES:
        raise ValueError(
            f"{name} of {dtype.name} has no row in the table of operations (jaxftc/compile/operations.py): add it, or write "
            "the step without it"
        )
    return found
