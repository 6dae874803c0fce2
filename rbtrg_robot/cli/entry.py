"""Entry of `rbtrg-robot`. `stop` takes a short way: the stop is sent before anything else is imported."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point."""
    words = sys.argv[1:]
    if words[:1] == ["stop"] and not {"-h", "--help"} & set(words):
        from rbtrg_robot.cli.stop import command

        sys.exit(command(words[1:]))
    try:
        from rbtrg_robot.cli.main import main as whole
    except KeyboardInterrupt:  # the imports take a second on a cold disk; nothing was sent yet
        sys.exit(130)
    whole()
