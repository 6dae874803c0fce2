"""The manual that `Help` opens: the pages of docs/ that lie on this computer. Nothing is loaded from elsewhere."""

from __future__ import annotations

import re
from html import escape
from itertools import pairwise
from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

PACKAGE = Path(__file__).resolve().parents[1]
DOCS = next((d for d in (PACKAGE / "docs", PACKAGE.parent / "docs") if d.is_dir()), PACKAGE / "docs")
"""In a wheel inside the package, in a checkout beside it."""
ABSENT = "This page is on the site only. In a checkout, `uv run --group docs mkdocs build` writes the site to site/.\n"


def anchor(heading: str) -> str:
    """What `page.md#...` names, as GitHub and the site spell it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def html_of(text: str) -> str:
    """A page of Markdown with the ids of its headings, as HTML."""
    from markdown_it import MarkdownIt

    reader = MarkdownIt("commonmark").enable("table")
    tokens = reader.parse(text)
    for opening, content in pairwise(tokens):
        if opening.type == "heading_open":
            opening.attrSet("id", anchor(content.content))
    title = escape(re.sub(r"^#+ *", "", text.partition("\n")[0]))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        '<link rel="stylesheet" href="/page/manual.css"></head><body>'
        '<nav><a href="/docs/README.md">All pages</a></nav>\n'
        f"<main>{reader.renderer.render(tokens, reader.options, {})}</main></body></html>\n"
    )


def _page(request: Request) -> Response:
    file = (DOCS / request.path_params["name"]).resolve()
    if file.suffix != ".md" or not file.is_relative_to(DOCS) or not file.is_file():
        return PlainTextResponse(ABSENT, 404)
    return HTMLResponse(html_of(file.read_text()))


ROUTES = [
    Mount("/docs/images", StaticFiles(directory=DOCS / "images", check_dir=False)),
    Route("/docs/{name:path}", _page),
]
