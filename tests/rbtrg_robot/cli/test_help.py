"""Help for people: on a terminal of 80 columns no line of it is cut off, and no type of Python stands in it."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from typer.main import get_command

from rbtrg_robot.cli.main import app

GROUPS = [[], *([group.name] for group in app.registered_groups)]
COMMANDS = [
    [*prefix, command.name or command.callback.__name__]
    for prefix, commands in (
        ([], app.registered_commands),
        *(
            ([str(g.name)], g.typer_instance.registered_commands)
            for g in app.registered_groups
            if g.typer_instance
        ),
    )
    for command in commands
    if command.callback
]


COMMAND = get_command(app)
"""Built once: for each call anew it takes most of the time."""


def told(*words: object) -> str:
    result = CliRunner().invoke(COMMAND, [*map(str, words), "--help"], env={"COLUMNS": "80"})
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("group", GROUPS, ids=str)
def test_what_a_command_does_fits_into_its_line(group: list[str]) -> None:
    lines = told(*group).partition("Commands:")[2].splitlines()
    assert len(lines) > 1
    assert not [line for line in lines if line.endswith("...")]


def test_no_type_of_python_is_shown() -> None:
    assert len(COMMANDS) > 40
    for words in COMMANDS:
        text = told(*words)
        options = text.partition("Options:")[2]
        assert "list[" not in options, words
        assert "float,float" not in options, words
