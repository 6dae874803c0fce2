"""Write the tables of parameters in the docs: `python -m tools.parameters`. A test compares them.

A page names keys of the configuration in a comment, `<!-- parameters: odometry.engine elevation.resolution -->`. The
table below the comment has their defaults and descriptions.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from rbtrg_robot.config import StackConfig

DOCS = Path(__file__).resolve().parents[1] / "docs"
MARK = re.compile(r"<!-- parameters: (.+?) -->\n(?:\|.*\n)*")
"""The comment with its keys, and the table below it."""
HEAD = "| key | default | meaning |\n|---|---|---|\n"


def row(key: str) -> str:
    """Of a key such as `odometry.engine`. Raises KeyError for one that there is not."""
    value: Any = StackConfig()
    meaning = ""
    for name in key.split("."):
        field = type(value).model_fields[name]
        value, meaning = getattr(value, name), field.description or ""
    if isinstance(value, tuple) and any(isinstance(one, BaseModel) for one in value):
        shown = "see `config show`"
    else:
        plain = list(value) if isinstance(value, tuple) else value
        text = yaml.safe_dump(plain, default_flow_style=True).removesuffix("...\n").strip()
        shown = f"`{text}`"
    return f"| `{key}` | {shown} | {meaning.replace('|', '/')} |\n"


def written(text: str) -> str:
    """A page with its tables as the configuration has them."""

    def table(found: re.Match[str]) -> str:
        keys = found[1].split()
        return f"<!-- parameters: {found[1]} -->\n" + HEAD + "".join(map(row, keys))

    return MARK.sub(table, text)


def pages() -> list[Path]:
    """Pages with tables of parameters."""
    return [page for page in sorted(DOCS.rglob("*.md")) if MARK.search(page.read_text())]


if __name__ == "__main__":
    for page in pages():
        page.write_text(written(page.read_text()))
