"""`python -m tools.bench console`."""

from tools.bench.console.bench import run

__all__ = ["run"]
