from tools.bench.closed_loop.bench import run

__all__ = ["run"]
