"""YAML from people: plain values, or one error that says what is wrong.

PyYAML raises whatever its constructors trip over, and a few lines of aliases can stand for any number of values."""

from __future__ import annotations

import math
from itertools import chain
from pathlib import Path
from typing import Any

import yaml

from hal.regular import open_regular

LARGEST_FILE = 1_000_000
"""Bytes. PyYAML takes 4 s for so many."""
MOST_ITEMS = 100_000
"""Values, with every alias written out."""
WRONG = (
    yaml.YAMLError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError,
)  # fmt: skip
"""What PyYAML raises for broken text, impossible dates and numbers, and brackets without end."""


class YamlError(ValueError):
    """No YAML, or too much of it; the message is one line."""


class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice in a mapping: YAML forbids it, PyYAML takes the last one."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if len(set(names)) < len(names):
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise yaml.constructor.ConstructorError(
                None, None, f"key {twice!r} stands twice", node.start_mark
            )
        return super().construct_mapping(node, deep)


def parse(text: str | bytes) -> Any:
    """The value in a text. Raises YamlError."""
    if len(text) > LARGEST_FILE:
        raise YamlError(f"more than {LARGEST_FILE:,} bytes")
    try:
        value = yaml.load(text, _Loader)
        many = _weight(value, {}) > MOST_ITEMS
    except WRONG as error:
        raise YamlError(" ".join(str(error).split()) or type(error).__name__) from error
    if many:
        raise YamlError(f"more than {MOST_ITEMS:,} values, with its aliases written out")
    return value


def read(path: Path) -> Any:
    """The value in a file. Raises OSError, YamlError."""
    with open_regular(path) as file:
        return parse(file.read(LARGEST_FILE + 1))


def _weight(value: Any, known: dict[int, float]) -> float:
    """How many values it is with every alias written out; infinity for one that holds itself."""
    if not isinstance(value, dict | list | tuple | set):
        return 1
    if id(value) not in known:
        known[id(value)] = math.inf
        parts = chain(value.keys(), value.values()) if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_weight(part, known) for part in parts)
    return known[id(value)]
