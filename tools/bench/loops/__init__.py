"""Maps that close: `python -m tools.bench loops`."""

from tools.bench.loops.bench import run

__all__ = ["run"]
