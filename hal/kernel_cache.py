"""Where numba keeps our compiled kernels, and what makes a kept one stale.

Numba compiles a kernel together with the kernels of other files that it calls, and keeps the result until the
caller's own file changes. After an upgrade in place an old callee would go on running. Here a kept kernel counts only
if its file, and every file of ours that this one imports directly or not, have the contents that it was compiled
from. (Numba itself checks its version and the processor.) Nothing is ever deleted: a stale kernel is compiled anew
and written over. So processes that start together, or run on the old sources, do not disturb each other.

`hal/__init__.py` names these classes in the environment, where numba looks for them: importing `hal`, `mapping` or
`planning` is enough."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

import hal.compiler  # noqa: F401  numba imports this module before it compiles

ROOT = Path(__file__).parent.parent
PACKAGES = ("hal", "mapping", "planning", "tools")
FACTS = "robot.yaml"
"""Numbers that kernels beside it freeze."""
_IMPORT = re.compile(
    rf"^(?:from[ ]+((?:{'|'.join(PACKAGES)})[\w.]*)[ ]+import[ ]+(\([^)]*\)|.*)"
    rf"|import[ ]+((?:{'|'.join(PACKAGES)})[\w.]*))",
    re.M,
)
"""An import at the top of a file: what a kernel calls, or freezes as a constant, must be known there."""


def imported(source: str) -> Iterator[str]:
    """Dotted names that may be modules of ours, of the imports at the top level of `source`."""
    for package, names, module in _IMPORT.findall(source):
        yield package or module
        for name in re.findall(r"\w+", names):
            yield f"{package}.{name}"


def file_of(module: str) -> Path | None:
    """The source of a module of ours; None if there is no such module."""
    path = ROOT.joinpath(*module.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


@cache
def _read(path: Path) -> tuple[bytes, frozenset[Path]]:
    """Hash and imports of a file, as this process found it first: later changes are not what it runs."""
    source = path.read_bytes()
    found = {file_of(name) for name in imported(source.decode())}
    return hashlib.sha256(source).digest(), frozenset(p for p in found if p is not None)


@cache
def stamp(path: Path) -> bytes:
    """Hash over a source file and all files of ours that it needs."""
    needed, new = {path}, [path]
    while new:
        more = _read(new.pop())[1] - needed
        needed |= more
        new.extend(more)
    digest = hashlib.sha256()
    for file in sorted(needed):
        digest.update(_read(file)[0])
    for facts in sorted({file.parent / FACTS for file in needed}):
        if facts.is_file():
            digest.update(facts.read_bytes())
    return digest.digest()


class _Stamped:
    """Numba's locator of a kept kernel, with the stamp above."""

    _py_file: str

    def get_source_stamp(self) -> bytes:
        """What must be the same for a kept kernel to count."""
        return stamp(Path(self._py_file).resolve())


class UserProvided(_Stamped, UserProvidedCacheLocator):  # type: ignore[misc]
    """In NUMBA_CACHE_DIR."""


class InTree(_Stamped, InTreeCacheLocator):  # type: ignore[misc]
    """Beside the source."""


class UserWide(_Stamped, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's cache, where the sources cannot be written to."""
