"""An independent ROS 2 client (zenoh-ros2-sdk) as a program of its own: `python ros2_client.py PORT FOLDER X Y`.

It joins late, discovers the topics, waits for one message of each it reads, sends a goal, and prints what it found as
JSON. FOLDER holds
the .msg files; the client must not fetch any.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path
from typing import Any

os.environ["GIT_PYTHON_REFRESH"] = "quiet"

from zenoh_ros2_sdk import (
    MessageRegistry,
    ROS2Publisher,
    ROS2Subscriber,
    ZenohSession,
    get_topic_names_and_types,
)
from zenoh_ros2_sdk.qos import QosProfile

LATCHED = QosProfile.decode("1:1:1,1:,:,:,,")
READS = {
    "/odom": ("nav_msgs/msg/Odometry", None),
    "/imu/data": ("sensor_msgs/msg/Imu", None),
    "/lidar/main/points": ("sensor_msgs/msg/PointCloud2", None),
    "/tf_static": ("tf2_msgs/msg/TFMessage", LATCHED),
    "/plan/path": ("nav_msgs/msg/Path", None),
}


def tell(topic: str, message: Any) -> Any:
    """What the test compares."""
    if topic == "/odom":
        return message.pose.pose.position.x
    if topic == "/imu/data":
        return message.linear_acceleration.z
    if topic == "/lidar/main/points":
        return [message.width, len(message.data)]
    if topic == "/tf_static":
        return [x.child_frame_id for x in message.transforms]
    return len(message.poses)


def main(port: int, folder: Path, x: float, y: float) -> None:
    def local(_self: object, name: str) -> Path | None:
        path = folder / f"{name}.msg"
        return path if path.exists() else None

    MessageRegistry.get_msg_file_path = local
    session = ZenohSession.get_instance("127.0.0.1", port)
    topics = dict(get_topic_names_and_types(router_port=port))
    got: dict[str, Any] = {}
    came = threading.Condition()

    def hear(topic: str) -> Any:
        def heard(message: Any) -> None:
            with came:
                got.setdefault(topic, tell(topic, message))
                came.notify()

        return heard

    held = [
        ROS2Subscriber(topic, kind, hear(topic), router_port=port, qos=qos)
        for topic, (kind, qos) in READS.items()
    ]
    goal = ROS2Publisher("/goal_pose", "geometry_msgs/msg/PoseStamped", router_port=port)
    types = session.store.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id="map"
    )
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    goal.publish(header=header, pose=pose)
    with came:
        came.wait_for(lambda: len(got) == len(READS), 20.0)
    print(json.dumps({"topics": topics, "got": got}), flush=True)
    for end in [*held, goal, session]:
        end.close()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
