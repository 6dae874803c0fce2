"""Other people's data: `python -m tools.bench outside`."""

from tools.bench.outside.bench import run

__all__ = ["run"]
