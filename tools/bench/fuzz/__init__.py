"""Broken messages on every topic: see `bench`."""

from tools.bench.fuzz.bench import run

__all__ = ["run"]
