"""Errors that an operator can mend. Every floor's own subclass this one; their text says how."""

from __future__ import annotations


class OperatorError(Exception):
    """Its text is one line that tells the operator what to do next; commands print it without a traceback."""

    retry: bool = False
    """Whether another attempt may succeed without help. A process that ends with such an error is started again."""

    def __init__(self, *args: object, retry: bool | None = None) -> None:
        """`retry` replaces the value of the class."""
        super().__init__(*args)
        if retry is not None:
            self.retry = retry


def one_line(error: BaseException) -> str:
    """The first line of an error's text, or the name of its class where it has none."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
