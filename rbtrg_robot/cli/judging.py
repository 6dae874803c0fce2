"""`log test`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from xml.etree import ElementTree as Xml

import typer

from rbtrg_robot.cli.logs import Json, log_app
from rbtrg_robot.terminal import plain, say, say_json

if TYPE_CHECKING:
    from rbtrg_robot.hosts.judging import Result

FAILED = 3
"""Exit status: a line does not hold. A file that is wrong ends with 1, as everywhere."""


def register(app: typer.Typer) -> None:
    """Add the command to `log`, which `logs` adds to the app."""
    del app
    log_app.command("test")(log_test)


def log_test(
    file: Annotated[Path, typer.Argument(metavar="FILE.yaml", help="What to judge, and by what.")],
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="[RUN...]", help="Logs, instead of those of the file.")
    ] = None,
    junit: Annotated[Path | None, typer.Option(metavar="FILE.xml", help="For CI: JUnit's XML.")] = None,
    logs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the logs of re-runs and drives.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Judge runs by a file of assertions. Exit status 3 where one does not hold."""
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.hosts.judging import Suite

    tests = Suite(file, tuple(runs or ()))
    results: list[Result] = []
    for result in tests.run(logs):
        results.append(result)
        if not as_json:
            _show(result)
    if junit is not None:
        try:
            junit.write_bytes(_junit(file.stem, tests.test.expect, results))
        except OSError as error:
            raise ConfigError(f"cannot write {junit}: {error.strerror}") from error
    held = sum(result.holds for result in results)
    if as_json:
        say_json([dataclasses.asdict(result) | {"holds": result.holds} for result in results])
    else:
        say(f"{held} of {len(results)} cases hold")
    if held < len(results):
        raise typer.Exit(FAILED)


def _show(result: Result) -> None:
    say(f"{result.case}  ({result.wall:.1f} s)")
    for verdict in result.verdicts:
        say(f"  {'ok  ' if verdict.holds else 'FAIL'}  {verdict.text:44s}  {verdict.told}")
    if result.error:
        say(f"  FAIL  {result.error}")
    for note in result.notes:
        say(f"  note: {note}")


def _junit(name: str, lines: tuple[str, ...], results: list[Result]) -> bytes:
    """As Jenkins, GitLab and GitHub read it: a test case for each line of each case."""
    suite = Xml.Element("testsuite", name=name)
    failures = errors = 0
    for result in results:
        told = {verdict.text: verdict for verdict in result.verdicts}
        for line in lines:
            time = f"{result.wall / len(lines):.3f}"
            one = Xml.SubElement(
                suite, "testcase", classname=f"{name}.{plain(result.case)}", name=plain(line), time=time
            )
            if line not in told:
                errors += 1
                Xml.SubElement(one, "error", message=plain(result.error))
            elif not told[line].holds:
                failures += 1
                Xml.SubElement(one, "failure", message=plain(told[line].told))
    for key, count in (
        ("tests", len(results) * len(lines)),
        ("failures", failures),
        ("errors", errors),
        ("skipped", 0),
    ):
        suite.set(key, str(count))
    root = Xml.Element("testsuites")
    root.append(suite)
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))
