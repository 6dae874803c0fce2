"""The ROS 2 package `rbtrg_msgs`: what it lists is what the definitions need."""

from __future__ import annotations

import re
from xml.etree import ElementTree as Xml

from rbtrg_robot.wire.messages import OURS
from tests.places import ROOT

PACKAGE = ROOT / "ros2" / "rbtrg_msgs"


def needed() -> set[str]:
    """Packages whose types our definitions use."""
    found = set()
    for file in (PACKAGE / "msg").glob("*.msg"):
        found |= set(re.findall(r"^([a-z_]+)/[A-Z]\w*", file.read_text(), re.MULTILINE))
    return found - {"rbtrg_msgs"}  # itself


def test_the_package_has_every_message_of_ours() -> None:
    ours = {name.rsplit("/", 1)[1] for name in OURS if name.startswith("rbtrg_msgs/")}
    assert {file.stem for file in (PACKAGE / "msg").glob("*.msg")} == ours
    assert len(ours) > 10


def test_both_files_name_what_the_definitions_use() -> None:
    package = Xml.parse(PACKAGE / "package.xml").getroot()
    assert package.findtext("name") == "rbtrg_msgs"
    assert {element.text for element in package.findall("depend")} == needed()
    cmake = (PACKAGE / "CMakeLists.txt").read_text()
    dependencies = re.search(r"DEPENDENCIES ([\w ]+)\)", cmake)
    assert dependencies is not None
    assert set(dependencies[1].split()) == needed()
    for name in ("ament_cmake", "rosidl_default_generators", *needed()):
        assert f"find_package({name} REQUIRED)" in cmake
