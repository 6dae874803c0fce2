"""RViz configuration and Foxglove layout: every topic they name exists, with the type and the QoS that they want."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from hal.robots.go2w.urdf import urdf
from rbtrg_robot import topics as t
from rbtrg_robot.bridge.foxglove import BACK, STOP
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import build_stages
from rbtrg_robot.scope import Scope
from rbtrg_robot.topics import Qos
from rbtrg_robot.wire.messages import STORE
from tests.places import ROOT

RVIZ: dict[str, Any] = yaml.safe_load((ROOT / "ros2" / "rbtrg.rviz").read_text())["Visualization Manager"]
LAYOUT: dict[str, Any] = json.loads((ROOT / "ros2" / "foxglove.json").read_text())
SHOWS = {
    "rviz_default_plugins/RobotModel": "std_msgs/msg/String",
    "grid_map_rviz_plugin/GridMap": "grid_map_msgs/msg/GridMap",
    "rviz_default_plugins/Map": "nav_msgs/msg/OccupancyGrid",
    "rviz_default_plugins/PointCloud2": "sensor_msgs/msg/PointCloud2",
    "rviz_default_plugins/Path": "nav_msgs/msg/Path",
    "rviz_default_plugins/Odometry": "nav_msgs/msg/Odometry",
    "rviz_default_plugins/SetGoal": "geometry_msgs/msg/PoseStamped",
}
"""Type that a display or tool of RViz takes."""
PANELS = {
    "RawMessages": None,
    "DiagnosticSummary": "diagnostic_msgs/msg/DiagnosticArray",
}


def shown() -> Iterator[tuple[str, dict[str, Any]]]:
    for item in (*RVIZ["Displays"], *RVIZ["Tools"]):
        place = item.get("Topic") or item.get("Description Topic")
        if place:
            yield item["Class"], place


@pytest.mark.parametrize(("kind", "place"), list(shown()))
def test_rviz_shows_topics_of_the_table(kind: str, place: dict[str, Any]) -> None:
    topic = t.BY_NAME[place["Value"]]
    assert topic.type == SHOWS[kind]
    latched = place["Durability Policy"] == "Transient Local"
    assert latched == (topic.qos is Qos.LATCHED)
    if topic.qos is Qos.SENSOR:  # a reliable reader gets nothing from a best effort writer
        assert place["Reliability Policy"] == "Best Effort"


def test_the_configuration_is_made_that_of_a_robot_with_a_name_as_the_docs_say() -> None:
    """`sed 's#Value: /#Value: /a/#'` changes the topics, all of them and nothing else."""
    text = (ROOT / "ros2" / "rbtrg.rviz").read_text()
    named = yaml.safe_load(text.replace("Value: /", "Value: /a/"))["Visualization Manager"]
    topics = {Scope.of(0, "a").topic(place["Value"]) for _, place in shown()}
    assert set(re.findall(r"(?<=Value: )/a/\S+", text.replace("Value: /", "Value: /a/"))) == topics
    assert named["Global Options"] == RVIZ["Global Options"]


def test_rviz_knows_our_frames() -> None:
    assert RVIZ["Global Options"]["Fixed Frame"] == "map"
    assert len(list(shown())) == 8


def field_exists(typename: str, path: list[str]) -> bool:
    """Whether a message has this field."""
    for name in path:
        found = dict(STORE.fielddefs[typename][1]).get(name)
        if found is None:
            return False
        typename = str(found[1]) if int(found[0]) == 2 else ""
    return True


def test_foxglove_shows_topics_of_the_table() -> None:
    named = set()
    for name, config in LAYOUT["configById"].items():
        panel = name.split("!")[0]
        if panel == "3D":
            assert set(config["topics"]) <= set(t.BY_NAME)
            named |= set(config["topics"])
            assert t.BY_NAME[config["publish"]["poseTopic"]] in BACK
            layers = [x for x in config["layers"].values() if x.get("sourceType") == "topic"]
            assert [t.BY_NAME[x["topic"]] for x in layers] == [t.DESCRIPTION]
        elif panel == "Plot":
            for path in config["paths"]:
                topic, *fields = re.split(r"\.", path["value"])
                assert field_exists(t.BY_NAME[topic].type, fields), path["value"]
                named.add(topic)
        elif panel == "Publish":
            topic_row = t.BY_NAME[config["topicName"]]
            assert topic_row in STOP
            assert topic_row.type == config["datatype"]
            fields = [name for name, _ in STORE.fielddefs[topic_row.type][1]]
            assert list(json.loads(config["value"])) == fields
        else:
            topic_row = t.BY_NAME[config.get("topicPath") or config["topicToRender"]]
            assert PANELS[panel] in (None, topic_row.type)
            named.add(topic_row.name)
    assert len(named) >= 8


def test_every_panel_of_the_layout_is_configured_and_shown() -> None:
    def leaves(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else leaves(node["first"]) | leaves(node["second"])

    assert leaves(LAYOUT["layout"]) == set(LAYOUT["configById"])


def test_the_description_is_told_once_to_whoever_comes() -> None:
    (stage, _period) = build_stages(load(scene="flat"), ["odometry"])["odometry"]
    told = [message.data for topic, message in stage.tick(1) if topic is t.DESCRIPTION]
    assert told == [urdf()]
    assert t.DESCRIPTION.qos is Qos.LATCHED
    assert stage.tick(2) == []
