"""YAML beside a network: bounded, and without any tag that makes an object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from hal.regular import open_regular
from hal.robots.go2w.locomotion.torchfile import PolicyError

LARGEST_FILE = 200_000
"""Bytes; the public ones have 5,000."""
_SLICE = "tag:yaml.org,2002:python/object/apply:builtins.slice"
"""unitree_rl_lab writes "all joints" so."""


class _Loader(yaml.SafeLoader):
    """Reads the tag of "all joints" as nothing. An alias stands for plain values alone: of aliases of aliases a few
    lines can stand for a gigabyte."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Raises a YAMLError for an alias of more than plain values."""
        alias = self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        if alias and isinstance(node, yaml.CollectionNode) and not _plain(node):
            raise yaml.YAMLError("it has an alias (*name) of more than numbers: write it out")
        return node  # type: ignore[no-any-return]


def _plain(node: yaml.CollectionNode) -> bool:
    return isinstance(node, yaml.SequenceNode) and all(isinstance(v, yaml.ScalarNode) for v in node.value)


_Loader.add_constructor(_SLICE, lambda *_: None)


def read_yaml(path: Path) -> dict[str, Any]:
    """The `key: value` lines of a file. Raises PolicyError."""
    try:
        with open_regular(path) as file:
            data = file.read(LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:
            raise PolicyError(f"{path} has more than {LARGEST_FILE // 1000} kB: that describes no policy")
        tree = yaml.load(data.decode(), Loader=_Loader)
    except FileNotFoundError as error:
        raise PolicyError(f"{path} is missing: give the folder of a policy with its description") from error
    except OSError as error:
        raise PolicyError(f"{path} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise PolicyError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from error
    if not isinstance(tree, dict) or not tree:
        raise PolicyError(f"{path} must hold `key: value` lines")
    return tree


def first_error(error: ValidationError) -> str:
    """The first thing that is wrong, in one line."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    return f"{key + ': ' if key else ''}{first['msg']}"
