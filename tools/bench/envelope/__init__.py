from tools.bench.envelope.bench import run

__all__ = ["run"]
