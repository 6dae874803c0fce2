"""`python -m tools.bench NAME [options] [--json]`: run one benchmark, print its rows, exit 1 on a missed limit, 130 where it is ended before.

SIGTERM ends it as Ctrl-C does, so that no stack that it started is left behind.
"""

from __future__ import annotations

import importlib
import pkgutil
import signal
import sys

import tools.bench
from hal.errors import OperatorError


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
    return 0 if report.ok else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
