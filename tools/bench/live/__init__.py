from tools.bench.live.bench import run

__all__ = ["run"]
