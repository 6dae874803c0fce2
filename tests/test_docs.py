"""The docs hold together: every link leads to a page and a heading, and every page that the code names exists."""

import json
import re
import subprocess

import pytest

from tests.places import ROOT

PAGES = sorted(p for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/*.ipynb")])


def words(path) -> str:
    """The prose of a page: a notebook's markdown cells, a page without its code blocks."""
    text = path.read_text()
    if path.suffix == ".ipynb":
        return "\n".join(
            "".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "markdown"
        )
    return re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)


def anchors(path) -> set[str]:
    """What `page.md#...` may name: headings as GitHub and mkdocs spell them."""
    heads = re.findall(r"^#+ +(.+?)\s*$", words(path), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    links = re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", words(page))
    dead = []
    for link in (a or b for a, b in links):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(link)
    assert not dead


def test_every_page_that_the_code_names_exists():
    files = subprocess.run(
        [
            "git",
            "-C",
            str(ROOT),
            "grep",
            "-hoE",
            r"(^|[^/[:alnum:]])docs/[a-zA-Z0-9_/.-]+\.(md|png|ipynb|json)",
            "--",
            "*.py",
            "*.js",
            "*.html",
            "*.toml",
        ],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\n")
    named = {re.sub(r"^.*?docs/", "docs/", line) for line in files if line}
    assert named
    assert not [n for n in sorted(named) if not (ROOT / n).exists()]
