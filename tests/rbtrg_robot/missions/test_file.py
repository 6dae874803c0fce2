"""Mission files: what they may say, GeoJSON, and a recorded drive."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rbtrg_robot.missions import file, geojson
from rbtrg_robot.missions.file import MissionError, MissionFile, dump, numbered, parse
from rbtrg_robot.missions.geojson import Origin, from_geojson, to_geojson
from rbtrg_robot.missions.recording import Recording
from rbtrg_robot.stages.mission.order import EVERYWHERE, Kind, refusal
from rbtrg_robot.wire.messages import encode

EXAMPLE = """
name: evening round
map: sha256:0123456789abcdef
on_failure: retry 2
on_comms_loss: hold
home: {x: 0, y: 0}
steps:
  - goto: {x: 3.0, y: 1.0, yaw_deg: 90, timeout: 60}
    id: gate
  - loop:
      times: 3
      steps:
        - ask: {question: "Is the valve open?", choices: [yes, no]}
          on_failure: skip
        - loop:
            times: forever
            steps: [sit, wait: 5, posture: stand]
  - record: {name: valve}
  - record: {name: noise, seconds: 4}
  - photo
"""


def test_a_file_becomes_an_order() -> None:
    mission = parse(yaml.safe_load(EXAMPLE), "f.yaml")
    order = mission.order("o", start=2, owner="anna")
    assert [(s.id, s.kind) for s in order.steps] == [
        ("gate", "goto"),
        ("ask-2", "ask"),
        ("sit-3", "sit"),
        ("wait-4", "wait"),
        ("stand-5", "stand"),
        ("record-6", "record"),
        ("record-7", "record"),
        ("photo-8", "photo"),
    ]
    assert [(loop.first, loop.last, loop.times) for loop in order.loops] == [(2, 5, 3), (3, 5, 0)]
    gate, ask = order.steps[:2]
    assert (gate.x, gate.y, gate.yaw, gate.has_yaw, gate.timeout) == (3.0, 1.0, math.pi / 2, True, 60.0)
    assert (gate.on_failure, gate.retries) == ("retry", 2)
    assert (ask.on_failure, ask.retries, ask.choices) == ("skip", 0, ["yes", "no"])  # not True and False
    assert [s.blocking_type for s in order.steps] == ["HARD"] * 5 + ["NONE", "HARD", "HARD"]
    assert (order.has_home, order.on_comms_loss, order.start) == (True, "hold", 2)
    assert refusal(order, EVERYWHERE | {Kind.RECORD, Kind.PHOTO}, "sha256:0123456789abcdef") == ""
    assert "     steps 2 to 5, 3 times:" in list(numbered(order))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("steps: []", "at least 1 item"),
        ("nme: 3\nsteps: [sit]", "nme: there is no such key"),
        ("steps: [dance]", "step 1: Input should be 'stand', 'sit', 'home', 'dock' or 'photo'"),
        ("steps: [sit, {gogo: 1}]", "step 2: a step is one of"),
        ("steps: [{wait: 1, sit: 2}]", "step 1 sit: there is no such key"),
        ("steps: [{goto: {x: 1}}]", "step 1 y: Field required"),
        ("steps: [{wait: .nan}]", "finite"),
        ("steps: [{wait: 1, on_failure: retry}]", "retry N"),
        ("steps: [{loop: {times: 0, steps: [sit]}}]", "greater than or equal to 1"),
        ("frame: odom\nsteps: [sit]", "'map'"),
        ("[1]", "key: value"),
        ("{", "not YAML"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_the_place(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(MissionError) as error:
        file.load(path)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_places_are_moved_by_the_numbers_of_their_steps() -> None:
    steps = [
        "stand",
        {"loop": {"times": 2, "steps": [{"goto": {"x": 1, "y": 2, "yaw_deg": 3}}, {"wait": 1}]}},
    ]
    mission = parse({"steps": [*steps, {"goto": {"x": 4, "y": 5}, "on_failure": "skip"}]}, "it")
    moved = mission.moved({2: (7.0, 8.0), 4: (9.0, -1.0)}).order("a")
    assert [(s.kind, s.x, s.y) for s in moved.steps if s.kind == "goto"] == [
        ("goto", 7.0, 8.0),
        ("goto", 9.0, -1.0),
    ]
    assert moved.steps[1].yaw == pytest.approx(math.radians(3.0))
    assert moved.steps[3].on_failure == "skip"
    assert mission.moved({}) == mission
    for wrong in (1, 3, 5):
        with pytest.raises(MissionError, match=f"step {wrong} is no `goto`"):
            mission.moved({wrong: (0.0, 0.0)})


def test_the_schema_is_one_that_others_can_use() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = MissionFile.model_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(yaml.safe_load(EXAMPLE.replace("[yes, no]", "['yes', 'no']")), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"steps": ["dance"]}, schema)


NUMBERS = st.floats(-500, 500, allow_nan=False).map(lambda v: round(v, 3))
LEAVES = st.one_of(
    st.sampled_from(["stand", "sit"]),
    st.builds(lambda x, y: {"goto": {"x": x, "y": y}}, NUMBERS, NUMBERS),
    st.builds(
        lambda x, y, a: {"goto": {"x": x, "y": y, "yaw_deg": a}, "on_failure": "retry 3"},
        NUMBERS,
        NUMBERS,
        NUMBERS,
    ),
    st.builds(lambda s: {"wait": s}, st.floats(0, 100)),
    st.builds(lambda text: {"ask": {"question": text}}, st.text(min_size=1, max_size=5)),
)
STEPS = st.recursive(
    st.lists(LEAVES, min_size=1, max_size=3),
    lambda inner: st.lists(
        LEAVES
        | st.builds(
            lambda n, s: {"loop": {"times": n, "steps": s}}, st.sampled_from([1, 2, "forever"]), inner
        ),
        min_size=1,
        max_size=3,
    ),
    max_leaves=5,
)


@settings(max_examples=60, deadline=None)
@given(STEPS, st.booleans())
@example([{"ask": {"question": "\x85a"}}, {"ask": {"question": "\u2028"}}], False)
def test_yaml_and_geojson_carry_the_whole_mission(steps: Any, on_earth: bool) -> None:
    mission = parse({"name": "a", "steps": steps}, "m")
    assert parse(yaml.safe_load(dump(mission)), "m") == mission
    origin = Origin(31.18, 121.59, 0.3) if on_earth else None
    content = json.loads(json.dumps(to_geojson(mission, origin)))
    again = from_geojson(content, "m", origin)
    wanted, got = mission.order("o"), again.order("o")
    for a, b in zip(wanted.steps, got.steps, strict=True):
        assert (b.x, b.y) == pytest.approx((a.x, a.y), abs=1e-6)
        a.x, a.y = b.x, b.y
    assert encode(wanted) == encode(got)


def test_a_place_on_the_earth_is_where_geodesy_says() -> None:
    def ecef(lat: float, lon: float) -> np.ndarray:
        """On the ellipsoid [m]; the oracle."""
        p, q = math.radians(lat), math.radians(lon)
        n = 6378137.0 / math.sqrt(1 - 6.69437999014e-3 * math.sin(p) ** 2)
        return np.array(
            [
                n * math.cos(p) * math.cos(q),
                n * math.cos(p) * math.sin(q),
                n * (1 - 6.69437999014e-3) * math.sin(p),
            ]
        )

    lat, lon, yaw = 31.18, 121.59, 0.3
    origin = Origin(lat, lon, yaw)
    for x, y in ((300.0, -400.0), (-20.0, 5.0), (0.0, 0.0)):
        longitude, latitude = origin.to_earth(x, y)
        d = ecef(latitude, longitude) - ecef(lat, lon)
        p, q = math.radians(lat), math.radians(lon)
        east = -math.sin(q) * d[0] + math.cos(q) * d[1]
        north = -math.sin(p) * (math.cos(q) * d[0] + math.sin(q) * d[1]) + math.cos(p) * d[2]
        got = (
            math.cos(yaw) * east + math.sin(yaw) * north,
            math.cos(yaw) * north - math.sin(yaw) * east,
        )
        assert got == pytest.approx((x, y), abs=0.03)
        assert origin.to_map(longitude, latitude) == pytest.approx((x, y), abs=1e-6)


def test_a_drawn_map_becomes_a_mission() -> None:
    line = {"type": "LineString", "coordinates": [[0.0, 0.0], [2.0, 1.0]]}
    point = {"type": "Point", "coordinates": [5.0, 0.0, 12.0]}
    drawn = {
        "type": "FeatureCollection",
        "frame": "map",
        "features": [
            {"type": "Feature", "geometry": line, "properties": {"stroke": "#f00"}},
            {"type": "Feature", "geometry": point, "properties": {"yaw_deg": 90}},
        ],
    }
    steps = from_geojson(drawn, "m").order("o").steps
    assert [(s.x, s.y, s.has_yaw) for s in steps] == [(0, 0, False), (2, 1, False), (5, 0, True)]
    with pytest.raises(MissionError, match="--origin"):
        from_geojson({k: v for k, v in drawn.items() if k != "frame"}, "m")
    polygon = {"type": "Polygon", "coordinates": [[[0, 0]]]}
    drawn["features"] = [{"type": "Feature", "geometry": polygon, "properties": {}}]
    with pytest.raises(MissionError, match="a Polygon"):
        from_geojson(drawn, "m")


def test_a_geojson_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "m.geojson"
    with pytest.raises(MissionError, match="cannot read"):
        geojson.load(path)
    for text in ("{", "[]", '{"type": "FeatureCollection", "frame": "map"}'):
        path.write_text(text)
        with pytest.raises(MissionError):
            geojson.load(path)


def test_a_drive_becomes_a_mission() -> None:
    recording = Recording("round", "sha256:0123456789abcdef", spacing=2.0)
    assert "not known" in recording.say("")
    with pytest.raises(MissionError, match="nothing was recorded"):
        recording.mission()
    for k in range(6):
        recording.at((k * 1.0, 0.0, 0.0))
    assert recording.say("\n").startswith("step 4")
    assert "undo" in recording.say("dance")
    assert "undo" in recording.say("wait long")
    for words in ("wait 5", "ask open?", "sit", "record valve"):
        assert recording.say(words).startswith("step")
    assert recording.say("undo") == "7 steps"
    mission = recording.mission()
    order = mission.order("o")
    assert [s.kind for s in order.steps] == ["goto"] * 4 + ["wait", "ask", "sit"]
    assert [s.x for s in order.steps[:4]] == [0.0, 2.0, 4.0, 5.0]
    assert (mission.name, mission.map) == ("round", "sha256:0123456789abcdef")
    assert parse(yaml.safe_load(dump(mission)), "m") == mission


@pytest.mark.parametrize(
    "text",
    [
        "steps: [[1]]",
        "steps: [~, 3]",
        "steps: !!pairs [a: 1]",
        "steps: [{loop: {times: 4294967296, steps: [stand]}}]",
    ],
)
def test_a_step_that_is_no_step_is_refused_in_words(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(MissionError, match="step 1"):
        file.load(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    "change",
    [
        {"features": [3]},
        {"features": [{"geometry": {"type": "Point", "coordinates": [10**400, 0]}}]},
        {"loops": [{"first": 1, "last": -5, "times": 2}]},
        {"mission": 3},
    ],
)
def test_geojson_that_is_no_mission_is_refused_in_words(change: dict[str, Any]) -> None:
    drawn = to_geojson(parse(yaml.safe_load("steps: [stand, sit]"), "m"))
    with pytest.raises(MissionError, match="is no mission"):
        from_geojson(drawn | change, "m.json")


@pytest.mark.parametrize("text", ["[" * 20_000, "9" * 5000, " " * 1_000_001])
def test_geojson_that_is_no_json_is_refused_in_words(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(MissionError, match=r"m\.json"):
        geojson.load(tmp_path / "m.json")
