"""`python -m tools.bench NAME [options] [--json] [--record FILE]`: run one benchmark and print its rows.

Exit status 1: a limit is missed; 130: it was ended. `--record FILE` also writes docs/measurements/FILE.json, which the
site shows.
SIGTERM ends it as Ctrl-C does, so that no stack that it started is left behind.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import shlex
import signal
import sys
from pathlib import Path

import tools.bench
from hal.errors import OperatorError

MEASUREMENTS = Path(__file__).resolve().parents[2] / "docs" / "measurements"


def main(argv: list[str]) -> int:
    """Dispatch to `tools.bench.NAME.run(args)`."""
    names = sorted(
        m.name
        for m in pkgutil.iter_modules(tools.bench.__path__)
        if m.name not in ("ports", "raised", "records", "report", "spent", "spread")
    )
    names = [n for n in names if not n.startswith("_")]
    if not argv or argv[0] not in names:
        print(f"usage: python -m tools.bench NAME [--json]; NAME is one of: {', '.join(names)}")
        return 2
    args = argv[1:]
    as_json = "--json" in args
    args = [a for a in args if a != "--json"]
    file = ""
    if "--record" in args:
        at = args.index("--record")
        file = args[at + 1] if at + 1 < len(args) else ""
        if not re.fullmatch(r"[a-z0-9_]+", file):
            print("error: --record wants a name of small letters, digits and _", file=sys.stderr)
            return 2
        del args[at : at + 2]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        report = importlib.import_module(f"tools.bench.{argv[0]}").run(args)
    except OperatorError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"error: {argv[0]} was interrupted before its rows were known", file=sys.stderr)
        return 130
    print(report.to_json() if as_json else report.to_text())
    if file:
        report.record(
            MEASUREMENTS / f"{file}.json", shlex.join(["python", "-m", "tools.bench", argv[0], *args])
        )
    return 0 if report.ok else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
