from tools.bench.perception.bench import run

__all__ = ["run"]
