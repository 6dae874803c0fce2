"""The docs hold together: links, names of pages and tests, plain words, and a docstring for each public name."""

import importlib
import inspect
import json
import re
import subprocess

import pytest

from tests.places import ROOT
from tools.docs import PAGES, PUBLIC

FILES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/*.ipynb")])
MADE = {ROOT / "docs" / name for name in PAGES}
"""Pages that exist on the site only."""
BOOK = [f for f in FILES if not {"measurements", "reference"} & set(f.parts) and f.name != "CHANGELOG.md"]
"""Pages that are read, not looked up."""
DIARY = (
    r"\b[Ss]eeds? \d",
    r"\b[Ll]anes? \d\d",
    r"\bversions? (of now|before)\b",
    r"\bas before\b",
    r"\b(simply|obviously|easily|just|whoever|whatever|thereof)\b",
)
"""What belongs to measurements, or to nobody."""
LONGEST = 25
"""Words of a sentence."""
WIDEST = 120
"""Columns of a line of prose or code; a row of a table is one line."""
MOST_WORDS = 25_000
"""Of docs/ without measurements and reference: prose and tables, not code."""
LINES_OF_A_SCREEN = 60


def text_of(file) -> str:
    """The prose of a page: a notebook's markdown cells, a page without its code blocks."""
    text = file.read_text()
    if file.suffix == ".ipynb":
        return "\n".join(
            "".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "markdown"
        )
    return re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M)


def anchors(file) -> set[str]:
    """What `page.md#...` may name: headings as GitHub and the site spell them."""
    heads = re.findall(r"^#+ +(.+?)\s*$", text_of(file), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in heads}


def sentences(text: str) -> list[str]:
    """Sentences, list items and cells of tables. Code counts as one word."""
    text = re.sub(r"^(    .*|#.*|\|[-| ]+\|)$", "\n", text, flags=re.M)
    text = re.sub(r"<[^>]+>|!\[[^]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`\n]+`", "CODE", text))
    blocks = re.split(r"\n\s*\n|\n *(?:[-*]|\d+\.) |\n\||\|", text)
    return [s for b in blocks for s in re.split(r"(?<=[.!?:;])\s+", " ".join(b.split())) if s]


def name(file) -> str:
    """For the names of the tests."""
    return str(file.relative_to(ROOT))


@pytest.mark.parametrize("file", FILES, ids=name)
def test_every_link_leads_somewhere(file):
    links = re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", text_of(file))
    dead = []
    for link in (a or b for a, b in links):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (file.parent / path).resolve() if path else file
        if target not in MADE and (not target.exists() or (anchor and anchor not in anchors(target))):
            dead.append(link)
    assert not dead


def broken(text: str, widest: int = WIDEST) -> list[str]:
    """Rules that a page of Markdown breaks: sentences, lines, words of a diary, commits."""
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.S | re.M)
    told = sentences(prose)
    found = [f"{len(s.split())} words: {s}" for s in told if len(s.split()) > LONGEST]
    found += [
        f"{len(line)} columns: {line}"
        for line in text.splitlines()
        if len(line) > widest and not line.lstrip().startswith(("|", "<", "!["))
    ]
    found += [m.group() for pattern in DIARY for m in re.finditer(pattern, " ".join(told))]
    return found + re.findall(r"`[0-9a-f]{7,12}`", prose)


def words(text: str) -> int:
    """Words, without code blocks, the bars of tables and other signs that stand alone."""
    lines = [line for line in text.splitlines() if not line.startswith("    ")]
    return sum(any(c.isalnum() for c in word) for line in lines for word in line.split())


@pytest.mark.parametrize("file", BOOK, ids=name)
def test_pages_are_plain(file):
    if file.suffix == ".ipynb":  # an editor wraps its lines
        assert not broken(text_of(file), 10_000)
    else:
        assert not broken(file.read_text())


@pytest.mark.parametrize(
    "text",
    [
        f"A sentence of {'many ' * 23}words.\n",
        f"A line of `{'x' * 110}` columns.\n",
        "It fell with seed 7.\n",
        "Lane 17 ran as before.\n",
        "Since `1a2b3c4d` it stands.\n",
    ],
)
def test_a_page_that_is_not_plain_is_found(text):
    assert broken(text)


def test_the_docs_stay_short():
    pages = [f for f in BOOK if f.is_relative_to(ROOT / "docs")]
    assert sum(words(text_of(f)) for f in pages) <= MOST_WORDS


def test_the_changelog_of_a_version_is_one_screen():
    text = (ROOT / "CHANGELOG.md").read_text()
    assert all(len(part.splitlines()) <= LINES_OF_A_SCREEN for part in text.split("\n## ")[1:])
    assert not [s for s in sentences(text) if len(s.split()) > LONGEST]


def test_every_page_that_the_code_names_exists():
    found = subprocess.run(
        [
            "git",
            "-C",
            str(ROOT),
            "grep",
            "-hoE",
            r"\bdocs/[a-zA-Z0-9_/.-]+\.(md|png|ipynb|json)\b",
            "--",
            "*.py",
            "*.js",
            "*.html",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    pages = {
        ROOT / line
        for line in found.stdout.split()
        if line not in ("docs/spec.md", "docs/measurements/FILE.json")
    }
    assert pages
    assert not [p for p in pages if p not in MADE and not p.exists()]


def test_every_test_that_the_hazards_name_exists():
    rows = re.findall(r"^\|.*\| (.*) \|$", (ROOT / "docs/reference/hazards.md").read_text(), flags=re.M)
    named = {n for row in rows for n in re.findall(r"`([\w/]+\.py)`", row)}
    assert len(named) > 50
    places = [ROOT / "tests", ROOT / "tests" / "rbtrg_robot"]
    assert not [n for n in sorted(named) if not any((place / n).is_file() for place in places)]


def test_what_the_docs_import_stands_in_the_reference():
    code = [c for f in FILES if f.suffix == ".ipynb" for c in json.loads(f.read_text())["cells"]]
    text = "\n".join([*(f.read_text() for f in FILES), *("".join(c["source"]) for c in code)])
    named = set(
        re.findall(r"^ *(?:from|import) ((?:hal|mapping|planning|rbtrg_robot)[\w.]*)", text, flags=re.M)
    )
    assert len(named) > 5
    assert named <= set(PUBLIC)


@pytest.mark.parametrize("module", PUBLIC)
def test_every_public_name_has_a_docstring(module):
    found = importlib.import_module(module)
    names = getattr(found, "__all__", None) or [
        n
        for n, o in vars(found).items()
        if not n.startswith("_") and getattr(o, "__module__", None) == module
    ]
    bare = [] if found.__doc__ else [module]
    for n in names:
        thing = getattr(found, n)
        if not (inspect.isclass(thing) or inspect.isroutine(thing)):
            continue
        bare += [] if thing.__doc__ else [n]
        if inspect.isclass(thing):
            own = [(m, f) for m, f in vars(thing).items() if inspect.isroutine(f) and not m.startswith("_")]
            bare += [f"{n}.{m}" for m, f in own if not inspect.getdoc(f)]
    assert not bare


def test_every_setting_has_a_description():
    from pydantic import BaseModel

    from rbtrg_robot.config import StackConfig

    def bare(model: BaseModel, lead: str) -> list[str]:
        found = []
        for key, field in type(model).model_fields.items():
            value = getattr(model, key)
            if isinstance(value, BaseModel):
                found += bare(value, f"{lead}{key}.")
            elif not field.description:
                found.append(lead + key)
        return found

    assert not bare(StackConfig(), "")


def orders(text: str) -> list[list[str]]:
    """The words of every `rbtrg-robot ...` in code."""
    code = re.findall(r"`(rbtrg-robot [^`\n]+)`", text)
    code += re.findall(r"^ {4,}(?:uv run |sudo \S*/)?(rbtrg-robot [^\n#]+)", text, flags=re.M)
    return [re.split(r"\s+", re.sub(r"[\[\]]", " ", line).strip())[1:] for line in code]


@pytest.fixture(scope="module")
def commands():
    """The command line."""
    import typer

    from rbtrg_robot.cli.main import app

    return typer.main.get_command(app)


@pytest.mark.parametrize("file", BOOK, ids=name)
def test_every_command_exists_with_its_options(file, commands):
    wrong = []
    for words in orders(file.read_text()):
        command = commands
        rest = list(words)
        while hasattr(command, "commands") and rest and rest[0] in command.commands:
            command = command.commands[rest.pop(0)]
        known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help", "--version"}
        strange = [w for w in rest if w.startswith("--") and w.partition("=")[0].rstrip(",") not in known]
        if strange or (words and words[0].islower() and command is commands):
            wrong.append(" ".join(words))
    assert not wrong
