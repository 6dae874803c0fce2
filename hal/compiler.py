"""Numba's compiler without work that its result does not depend on. Compiling takes Python more time than LLVM.

What is replaced here are private parts of numba; where one of them has
another shape in a later version, it stays as it is and takes its time."""

from __future__ import annotations

import inspect
from typing import Any

from numba.core import types
from numba.core.compiler import Flags
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

PLAIN_TYPES = (types.Number, types.Boolean, types.Literal)
"""Arguments for which a function always resolves to the same signature."""


def _without_entry_for_c() -> None:
    """Numba would compile an entry for C with each kernel and each of its own helpers, and nobody calls one."""
    if "no_cfunc_wrapper" in Flags.options:
        Flags.options["no_cfunc_wrapper"]._default = True


def _compare_what_is_set() -> None:
    """Compiler options are hashed and compared with each overload that is tried. Numba reads all of them through
    properties each time; the hash it takes of their names alone."""
    hashes: dict[type, int] = {}
    of_names = TargetConfig.__hash__

    def hashed(self: Any) -> int:
        kind = type(self)
        if kind not in hashes:
            hashes[kind] = of_names(self)
        return hashes[kind]

    def same(self: Any, other: object) -> bool:
        if not isinstance(other, TargetConfig):
            return NotImplemented
        as_set = type(self) is type(other) and self._values == other._values
        return as_set or self.values() == other.values()

    if hasattr(TargetConfig(), "_values"):
        TargetConfig.__hash__, TargetConfig.__eq__ = hashed, same  # type: ignore[method-assign,assignment]


def _remember_signatures() -> None:
    """`a + b` of two floats is looked for among thirty signatures of strings, lists and arrays, at every `+`."""
    look = BaseFunction.get_call_type

    def known(self: Any, context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        if kws or not all(isinstance(arg, PLAIN_TYPES) for arg in args):
            return look(self, context, args, kws)
        found: dict[tuple[Any, ...], Any] = self.__dict__.setdefault("_found", {})
        if args not in found:
            found[args] = look(self, context, args, kws)
        return found[args]

    if [*inspect.signature(look).parameters] == ["self", "context", "args", "kws"]:
        BaseFunction.get_call_type = known  # type: ignore[method-assign,assignment]


_without_entry_for_c()
_compare_what_is_set()
_remember_signatures()
