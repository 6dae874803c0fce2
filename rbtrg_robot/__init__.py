"""The middleware: topics, processes, bus, messages, supervisor, stages, recorder, replay, CLI."""

__version__ = "0.2.0"
