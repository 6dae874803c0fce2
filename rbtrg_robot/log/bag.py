"""A run's folder as a rosbag2: `metadata.yaml` beside its files, for `ros2 bag`, rosbags and whoever else opens
folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from mcap.summary import Summary

from rbtrg_robot.log.read import log_files
from rbtrg_robot.log.summary import summary_of

NAME = "metadata.yaml"
BAG_VERSION = 5
"""Of the description: the newest that ROS 2 Humble reads; later ones read it too."""


def describe(folder: Path) -> None:
    """Write `metadata.yaml` for the finished files of a run; nothing where there are none. Raises OSError, LogError."""
    parts = [(file, summary) for file in log_files(folder) if (summary := summary_of(file)) is not None]
    parts = [(file, summary) for file, summary in parts if _count(summary)]
    if not parts:
        return
    text = yaml.safe_dump({"rosbag2_bagfile_information": _information(parts)}, sort_keys=False)
    draft = folder / f".{NAME}"
    draft.write_text(text)
    draft.replace(folder / NAME)  # never half a file under that name


def _count(summary: Summary) -> int:
    return summary.statistics.message_count if summary.statistics else 0


def _information(parts: list[tuple[Path, Summary]]) -> dict[str, Any]:
    topics: dict[str, dict[str, Any]] = {}
    files = []
    for file, summary in parts:
        told = summary.statistics
        assert told is not None
        files.append(
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": told.message_start_time},
                "duration": {"nanoseconds": told.message_end_time - told.message_start_time},
                "message_count": told.message_count,
            }
        )
        for number, channel in summary.channels.items():
            if channel.message_encoding != "cdr":
                continue  # one other encoding and rosbags refuses the whole folder
            schema = summary.schemas.get(channel.schema_id)
            topic = topics.setdefault(
                channel.topic,
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": schema.name if schema else "",
                        "serialization_format": channel.message_encoding,
                        "offered_qos_profiles": channel.metadata.get("offered_qos_profiles", ""),
                    },
                    "message_count": 0,
                },
            )
            topic["message_count"] += told.channel_message_counts.get(number, 0)
    begin = min(s.statistics.message_start_time for _, s in parts if s.statistics)
    end = max(s.statistics.message_end_time for _, s in parts if s.statistics)
    return {
        "version": BAG_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": sum(_count(summary) for _, summary in parts),
        "topics_with_message_count": list(topics.values()),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file["path"] for file in files],
        "files": files,
    }
