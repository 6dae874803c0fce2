"""The pages of docs/reference, made from the code: `mkdocs build` calls `on_files`. `python -m tools.docs NAME` prints
one."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT = Path(__file__).resolve().parents[1]
PUBLIC = (
    "planning.search",
    "planning.graph",
    "planning.path",
    "planning.tracking",
    "planning.errors",
    "mapping.grid",
    "mapping.elevation",
    "mapping.odometry",
    "mapping.relocalise",
    "mapping.closing",
    "rbtrg_robot.config",
    "rbtrg_robot.hosts.lockstep",
    "rbtrg_robot.hosts.offline",
    "rbtrg_robot.hosts.plan",
    "rbtrg_robot.log.picture",
    "rbtrg_robot.log.trajectory",
    "hal.contract",
    "hal.types",
    "hal.scenes",
    "hal.robots",
    "hal.camera",
    "hal.lidar",
    "hal.mujoco.backend",
)
"""Modules that other programs may import; a name of them changes with the version only."""


def cell(text: str) -> str:
    """`text` in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def table(heads: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table in Markdown; its cells are Markdown already."""
    lines = [heads, tuple("---" for _ in heads), *rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in lines) + "\n"


def commands() -> str:
    """Every command with its arguments and options, from typer."""
    import typer

    from rbtrg_robot.cli.main import app

    def walk(command: Any, words: str) -> Iterator[str]:
        context = command.context_class(command, info_name=words)
        if hasattr(command, "commands"):
            for name, inner in sorted(command.commands.items()):
                if not inner.hidden:
                    yield from walk(inner, f"{words} {name}")
            return
        usage = " ".join(command.collect_usage_pieces(context))
        yield f"## {words.partition(' ')[2]}\n\n    {words} {usage}\n\n{command.help or ''}\n"
        rows = []
        for one in command.params:
            if getattr(one, "hidden", False) or one.name == "help":
                continue
            names = (
                [*one.opts, *one.secondary_opts] if one.param_type_name == "option" else [one.name.upper()]
            )
            default = (
                ""
                if one.default is None or callable(one.default) or one.default in (False, ())
                else f"`{one.default}`"
            )
            rows.append(
                (
                    ", ".join(f"`{name}`" for name in names),
                    cell(getattr(one, "help", "") or ""),
                    cell(default),
                )
            )
        if rows:
            yield table(("", "what", "default"), rows)

    whole = typer.main.get_command(app)
    return "# Command line\n\n`rbtrg-robot COMMAND --help` prints the same.\n\n" + "\n".join(
        walk(whole, "rbtrg-robot")
    )


def configuration() -> str:
    """Every setting with its default, limits and description, from the models."""
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo

    from rbtrg_robot.config import StackConfig

    def limits(field: FieldInfo) -> str:
        signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
        return ", ".join(
            f"{signs[n]} {getattr(m, n):g}" for m in field.metadata for n in signs if hasattr(m, n)
        )

    def told(value: Any) -> str:
        if isinstance(value, BaseModel):
            value = value.model_dump(mode="json")
        text = json.dumps(value, default=str)
        return f"`{text}`" if len(text) < 60 else "see `config show`"

    def walk(model: BaseModel, lead: str) -> Iterator[str]:
        rows, groups = [], []
        for name, field in type(model).model_fields.items():
            value = getattr(model, name)
            if isinstance(value, BaseModel):
                groups.append((name, value))
                continue
            rows.append((f"`{lead}{name}`", told(value), limits(field), cell(field.description or "")))
        title = lead.rstrip(".") or "The stack"
        doc = (type(model).__doc__ or "").strip()
        yield f"## {title}\n\n{doc}\n\n" + table(("key", "default", "limits", "what"), rows)
        for name, value in groups:
            yield from walk(value, f"{lead}{name}.")

    head = """# Configuration

`up --config FILE` reads YAML, `--set a.b=c` sets one key, and the options of `up` come last.
`config show` prints what counts, `config schema` the JSON schema.

"""
    return head + "\n".join(walk(StackConfig(), ""))


def topics() -> str:
    """Every topic, and the messages of this project."""
    from rbtrg_robot.topics import STACK, TOPICS

    rows = [
        (
            f"`{t.name}`",
            f"`{t.type}`",
            f"{t.rate:g}" if t.rate else "on event",
            t.qos.value,
            "every process" if t.owner == STACK else t.owner or "anybody",
            t.publish_by.value if t.publish_by else "",
            t.recorded.replace(" ", ", "),
            cell(t.doc),
        )
        for t in TOPICS
    ]
    heads = (
        "topic",
        "type",
        "rate [Hz]",
        "QoS",
        "published by",
        "from outside",
        "profiles that record it",
        "what",
    )
    text = (
        "# Topics and messages\n\nFrom `rbtrg_robot/topics.py`. *From outside*: the role that may publish "
        "it from another computer.\n\n"
    )
    text += table(heads, rows)
    for file in sorted((ROOT / "rbtrg_robot" / "wire" / "msgs" / "rbtrg_msgs").glob("*.msg")):
        text += f"\n## rbtrg_msgs/msg/{file.stem}\n\n```\n{file.read_text().strip()}\n```\n"
    return text


def http() -> str:
    """The doors of the console for programs, from its OpenAPI description."""
    from rbtrg_robot.console.api import description

    told = description("NAME")
    rows = []
    for path, calls in told["paths"].items():
        for method, call in calls.items():
            content = call.get("requestBody", {}).get("content", {}).get("application/json", {})
            body = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
            rows.append(
                (
                    method.upper(),
                    f"`{path}`",
                    f"[{body}](#{body.lower()})" if body else "",
                    cell(call["summary"]),
                )
            )
    text = (
        "# HTTP\n\n[A program of your own](../extend.md#a-program-of-your-own) shows how to come in. `GET "
        "/api` gives this as OpenAPI.\n\n"
    )
    text += table(("method", "path", "body", "what"), rows)
    for name, shape in sorted(told["components"]["schemas"].items()):
        needed = shape.get("required", [])
        fields = [
            (
                f"`{key}`",
                cell(json.dumps({k: v for k, v in one.items() if k not in ("title", "description")})),
                "yes" if key in needed else "",
                cell(one.get("description", "")),
            )
            for key, one in shape.get("properties", {}).items()
        ]
        text += f"\n## {name}\n\n{shape.get('description', '')}\n\n" + table(
            ("field", "schema", "needed", "what"), fields
        )
    return text


def python() -> str:
    """The modules that other programs may import; mkdocstrings fills them in."""
    head = "# Python\n\nArrays are NumPy; each docstring gives shape, dtype, unit and frame.\n\n"
    return head + "\n".join(f"::: {module}\n" for module in PUBLIC)


def monitors() -> str:
    """The table of `hal/safety/monitors.py`."""
    from hal.safety.monitors import MONITORS, Monitor

    def allowed(row: Monitor) -> str:
        unit = f" {row.unit}" if row.unit else ""
        if row.setting:
            limits = f"`{row.setting}`"
        elif math.isfinite(row.low) and math.isfinite(row.high):
            limits = f"{row.low:g} to {row.high:g}{unit}"
        elif math.isfinite(row.high):
            limits = f"&lt;= {row.high:g}{unit}"
        elif math.isfinite(row.low):
            limits = f">= {row.low:g}{unit}"
        else:
            limits = row.check.value
        return f"{limits}, against {row.against}" if row.against else limits

    head = """# Monitors

The checks of inputs, from `hal/safety/monitors.py`. [Safety](../operate/safety.md) has the limits
of the gate, [hazards](hazards.md) all hazards.
`python -m tools.bench faults --without MONITOR` shows what each one is good for.

Consequences, from the mildest on: *tell* (`status` says it), *degrade* (the input is not used),
*hold* (zero velocity while it lasts), *latch* (zero velocity until `resume`),
*lost* (the pose is unknown, the goal ends), *refuse* (the message, the file or the start).

"""
    heads = (
        "monitor",
        "stream",
        "allowed",
        "consequence",
        "judge",
        "the operator reads",
        "what to do",
        "test",
    )
    rows = [
        (
            row.name,
            cell(row.stream),
            allowed(row),
            str(row.consequence),
            cell(row.judge),
            cell(row.words),
            cell(row.remedy),
            f"`{row.test}`",
        )
        for row in MONITORS
    ]
    return head + table(heads, rows)


def results() -> str:
    """Every file of docs/measurements as a table: what `python -m tools.bench NAME --record FILE` wrote."""
    text = """# Results

What the benches measured on the simulated robot. A rate comes with its trials and its bound at 80 % confidence.
`python -m tools.bench NAME --record FILE` writes `docs/measurements/FILE.json`; this page shows those files.

"""
    for file in sorted((ROOT / "docs" / "measurements").glob("*.json")):
        told = {
            "title": file.stem,
            "command": "",
            "date": "",
            "commit": "",
            "machine": "",
            "note": "",
        } | json.loads(file.read_text())
        where = ", ".join(
            filter(None, (told["date"], told["commit"] and f"commit `{told['commit']}`", told["machine"]))
        )
        command = f"    {told['command']}\n\n" if told["command"] else ""
        text += f"## {told['title']}\n\n{command}{where}. {cell(told['note'])}\n\n"
        rows = []
        for row in told["rows"]:
            sign = ">=" if row["at_least"] else "&lt;="
            limit = "" if row["limit"] is None else f"{sign} {row['limit']:g}"
            bound = f"{sign} {row['bound_80']:.3f}" if row.get("bound_80") is not None else ""
            value = "none" if row["value"] is None else f"{row['value']:.5g}"
            rows.append(
                (f"`{row['key']}`", value, cell(row["unit"]), limit, str(row.get("trials", "")), bound)
            )
        text += table(("row", "value", "unit", "limit", "trials", "bound"), rows) + "\n"
    return text


def tutorial() -> str:
    """docs/tutorial.ipynb as a page: its text and code, not its outputs."""
    cells = json.loads((ROOT / "docs" / "tutorial.ipynb").read_text())["cells"]
    text = [
        "".join(c["source"]) if c["cell_type"] == "markdown" else f"```python\n{''.join(c['source'])}\n```"
        for c in cells
    ]
    return "\n\n".join(text) + "\n"


PAGES = {
    "reference/cli.md": commands,
    "reference/configuration.md": configuration,
    "reference/topics.md": topics,
    "reference/monitors.md": monitors,
    "reference/http.md": http,
    "reference/python.md": python,
    "measurements/results.md": results,
    "tutorial.md": tutorial,
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Called by mkdocs: the pages that are made join those of the folder."""
    from mkdocs.structure.files import File

    for name, made in PAGES.items():
        files.append(File.generated(config, name, content=made()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by mkdocs: the notebook is a page of the site."""
    return markdown.replace("tutorial.ipynb)", "tutorial.md)")


if __name__ == "__main__":
    print(PAGES[sys.argv[1]]())
