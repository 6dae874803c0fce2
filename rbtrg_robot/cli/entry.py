"""Where `rbtrg-robot` begins. `stop` goes its own short way: nothing else is imported before it is sent."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point."""
    words = sys.argv[1:]
    if words[:1] == ["stop"] and not {"-h", "--help"} & set(words):
        from rbtrg_robot.cli.stop import command

        sys.exit(command(words[1:]))
    from rbtrg_robot.cli.main import main as whole

    whole()
