from tools.bench.planning.bench import run

__all__ = ["run"]
