from tools.bench.static.bench import run

__all__ = ["run"]
