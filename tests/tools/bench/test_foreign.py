"""The bench of ordinary places: its table, and one drive."""

from __future__ import annotations

import pytest

from tools.bench import foreign


def record(kind: str, seed: int, **fields: object) -> dict[str, object]:
    base = {
        "key": f"{kind}.{seed}", "goal": f"places:{kind},{seed}/end", "controller": "hybrid", "map": "seen",
        "seed": seed, "level": 0, "outcome": "reached", "driven": 6.0, "shortest": 5.0, "time": 20.0, "tried": False,
    }  # fmt: skip
    return base | fields


def test_the_table_counts_what_was_reached_and_what_was_refused_in_time() -> None:
    records = [record("house", 0), record("house", 1, outcome="fell")]
    refused = {"level": 5, "outcome": "refused"}
    records += [
        record("moat", 0, **refused, driven=30.0, time=60.0),
        record("moat", 1, **refused, driven=10.0, time=200.0),
        record("moat", 2, level=5, outcome="aborted", tried=True),
    ]
    rows = {r.key: r.value for r in foreign.table(records).rows}
    assert rows["foreign.hybrid.seen.house.reached"] == 0.5
    assert rows["foreign.hybrid.seen.house.fell"] == 0.5
    assert rows["foreign.hybrid.seen.house.length"] == 1.2
    assert rows["foreign.hybrid.seen.moat.refused"] == 2 / 3
    assert rows["foreign.hybrid.seen.moat.entered"] == 1 / 3
    assert rows["foreign.hybrid.seen.moat.in_time"] == 1 / 3, "30 m are not too far where 23 m are looked at"


@pytest.mark.campaign
def test_building_stairs_are_driven_down_with_a_map() -> None:
    report = foreign.run(["--kinds", "stairs_17_28_down", "--seeds", "0", "--map", "prior", "--workers", "0"])
    rows = {r.key.rpartition(".")[2]: r.value for r in report.rows}
    assert rows["reached"] == 1.0
    assert rows["fell"] == 0.0
    assert report.ok, "the length is within its limit"
