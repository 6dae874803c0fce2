"""Functions of others by name: `package.module:function`, or the name of an entry point of theirs."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from hal.errors import OperatorError

PATTERN = r"^([A-Za-z_][\w-]*|[A-Za-z_][\w.]*:[A-Za-z_]\w*)$"
"""What a name looks like."""


class NamedError(OperatorError):
    """Nothing has this name; the message says what does."""


def named(name: str, what: str, group: str, own: tuple[str, ...] = ()) -> Any:
    """The function or class of a name. `what` it is, in words; `group` of entry points; `own`: names of ours that need
    no module. Raises NamedError."""
    target = name
    if ":" not in name:
        known = {point.name: point.value for point in entry_points(group=group)}
        if name not in known:
            names = ", ".join([*own, *sorted(known)])
            raise NamedError(f"no {what} {name!r}: use {names}, or package.module:function of your own")
        target = known[name]
    module, _, attribute = target.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise NamedError(
            f"{what} {name}: {error}; install the package, or name its folder in PYTHONPATH"
        ) from error
