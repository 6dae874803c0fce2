"""The report of a benchmark is written as a measurement that the site shows."""

import json

from tests.places import ROOT
from tools.bench.report import Report


def test_a_record_tells_where_it_comes_from_and_keeps_title_and_note(tmp_path):
    report = Report("kill")
    report.add("rest_after", 0.24, "s", limit=0.3)
    report.rate("stopped", 15, 16)
    file = tmp_path / "kill.json"
    report.record(file, "python -m tools.bench kill")
    told = json.loads(file.read_text())
    assert (told["title"], told["note"], told["command"]) == ("kill", "", "python -m tools.bench kill")
    assert told["rows"][0]["value"] == 0.24
    assert told["rows"][1]["trials"] == 16
    file.write_text(json.dumps(told | {"title": "Deaths", "note": "live"}))
    report.record(file, "python -m tools.bench kill --live")
    told = json.loads(file.read_text())
    assert (told["title"], told["note"], told["command"]) == (
        "Deaths",
        "live",
        "python -m tools.bench kill --live",
    )


def test_every_measurement_has_what_the_site_shows():
    files = sorted((ROOT / "docs" / "measurements").glob("*.json"))
    assert files
    for file in files:
        told = json.loads(file.read_text())
        assert {"bench", "title", "command", "date", "commit", "machine", "note", "rows"} == set(told), (
            file.name
        )
        assert told["rows"], file.name
