from tools.bench.unitree.bench import run

__all__ = ["run"]
