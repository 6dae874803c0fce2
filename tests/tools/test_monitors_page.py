"""The page of the monitors is the table."""

from tests.places import ROOT
from tools.monitors import page


def test_the_page_is_what_the_table_says() -> None:
    assert (ROOT / "docs" / "operate" / "monitors.md").read_text() == page(), (
        "python -m tools.monitors > docs/operate/monitors.md"
    )
