"""The tables of parameters in the docs are those of the configuration."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.parameters import pages, row, written


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_a_page_has_the_parameters_as_they_are(page: Path) -> None:
    assert page.read_text() == written(page.read_text()), "python -m tools.parameters"


def test_a_row_has_default_and_unit() -> None:
    assert row("elevation.resolution") == "| `elevation.resolution` | `0.04` | cell size [m] |\n"


def test_a_key_that_there_is_not_is_told() -> None:
    with pytest.raises(KeyError):
        row("elevation.colour")
