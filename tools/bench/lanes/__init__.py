from tools.bench.lanes.bench import run

__all__ = ["run"]
