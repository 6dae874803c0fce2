"""Faults injected into the whole stack: what moves after them, for how long, and what the operator reads."""

from tools.bench.faults.bench import run

__all__ = ["run"]
