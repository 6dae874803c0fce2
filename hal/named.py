"""Functions of others by name: `package.module:function`, or the name of an entry point of theirs."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from hal.errors import OperatorError

PATTERN = r"^([A-Za-z_][\w-]*|[A-Za-z_][\w.]*:[A-Za-z_]\w*)$"
"""What a name looks like."""
BESIDE = r"^\.[A-Za-z_]\w*:[A-Za-z_]\w*$"
"""What the name of a part of the same folder looks like, `.module:function`."""


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


def beside(folder: Path, name: str, what: str) -> Any:
    """What `.module:function` means in `folder`, a package that nobody needs to install. Raises NamedError."""
    module, _, attribute = name.removeprefix(".").partition(":")
    package = f"{folder.name}@{folder.resolve()}".replace(".", "_")
    try:
        if package not in sys.modules:
            init = folder / "__init__.py"
            spec = spec_from_file_location(package, init, submodule_search_locations=[str(folder)])
            if spec is None or spec.loader is None or not init.is_file():
                raise ImportError(f"{folder} is no package: it has no __init__.py")
            sys.modules[package] = module_from_spec(spec)
            spec.loader.exec_module(sys.modules[package])
        return getattr(import_module(f"{package}.{module}"), attribute)
    except (ImportError, AttributeError, SyntaxError) as error:
        raise NamedError(f"{what} {name}: {error}; it is looked for in {folder}") from error
