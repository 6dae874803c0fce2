"""Exploration of generated sites, by the planner's library alone and by the whole stack."""

from tools.bench.explore.bench import run

__all__ = ["run"]
