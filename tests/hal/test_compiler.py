"""Numba's compiler with what `hal/compiler.py` leaves out, against numba's own."""

import operator
import subprocess
import sys

import pytest
from numba import types
from numba.core.compiler import Flags
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

import hal.compiler  # noqa: F401

KERNEL = """
import math, sys
from numba.core.compiler import Flags
Flags.options["no_cfunc_wrapper"]._default = True
if sys.argv[1] == "ours":
    import hal.compiler
from numba import njit
@njit
def leaf(a, b):
    return math.hypot(a, b) if a > b else -a // 3 + 2**3 + max(a, b, 1)
@njit
def kernel(x, n):
    total, bits = 0.0, 0
    for i in range(n):
        total += leaf(x, float(i)) + i % 3 - (i >> 1) + min(i, 3) * 2.5
        bits ^= i
        if not (total < 3.0 and bits != 2):
            total -= abs(x) * int(total)
    return total, bits, n / 2, n // 2
kernel(2.0, 5)
for compiled in (leaf, kernel):
    print(*(sorted(compiled.inspect_asm().values())), sep="")
"""


def machine_code(compiler: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", KERNEL, compiler], check=True, capture_output=True, text=True, timeout=120
    ).stdout


def test_the_machine_code_is_the_same() -> None:
    ours = machine_code("ours")
    assert ours.count("\n") > 100
    assert ours == machine_code("numba's")


def test_a_signature_is_looked_for_once() -> None:
    context = cpu_target.typing_context
    context.refresh()
    add = context.resolve_value_type(operator.add)
    found = add.get_call_type(context, (types.int64, types.float64), {})
    assert found.return_type == types.float64
    assert add.get_call_type(context, (types.int64, types.float64), {}) is found
    assert add.get_call_type(context, (types.int64, types.int64), {}).return_type == types.int64


def test_what_does_not_fit_is_refused_each_time() -> None:
    context = cpu_target.typing_context
    context.refresh()
    shift = context.resolve_value_type(operator.lshift)
    for _ in range(2):
        with pytest.raises(TypingError):
            shift.get_call_type(context, (types.float64, types.float64), {})


def test_options_are_equal_where_all_of_them_are() -> None:
    plain, given, other = Flags(), Flags(), Flags()
    given.nrt = plain.nrt
    other.nrt = not plain.nrt
    assert plain == given
    assert hash(plain) == hash(given)
    assert plain != other
    assert plain != 1
