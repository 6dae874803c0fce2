"""Messages as text a person can read: long arrays are cut."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

LONGEST_LIST = 16


def as_text(message: Any, indent: int = 0) -> str:
    """YAML-like lines."""
    pad = "  " * indent
    lines = []
    for field in fields(message):
        if field.name == "__msgtype__":
            continue
        value = getattr(message, field.name)
        if is_dataclass(value):
            lines += [f"{pad}{field.name}:", as_text(value, indent + 1)]
        elif isinstance(value, list) and value and is_dataclass(value[0]):
            lines.append(f"{pad}{field.name}: # {len(value)} items")
            for item in value[:LONGEST_LIST]:
                first, *rest = as_text(item, indent + 1).splitlines()
                lines += [f"{pad}- {first.strip()}", *rest]
        else:
            lines.append(f"{pad}{field.name}: {_scalar(value)}")
    return "\n".join(lines)


def _scalar(value: Any) -> str:
    if isinstance(value, np.ndarray | list):
        shown = ", ".join(_scalar(v) for v in value[:LONGEST_LIST])
        more = f", ... {len(value)} items" if len(value) > LONGEST_LIST else ""
        return f"[{shown}{more}]"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(value)
    return str(value)
