"""Robot and goal in one line each, from the supervisor's status: the same words in the terminal and in the console."""

from __future__ import annotations

from typing import Any

from rbtrg_robot.stages.navigation.reasons import words

POSE_AGE = 1.0
"""A pose older than this [s] is of the past, and its speed is not told any more."""


def held(hold: str) -> str:
    """Why the gate lets nothing through, from RobotState's `hold`; empty where it does."""
    return f"held ({hold})" if hold and hold != "no command" else ""


def slowed(reason: str) -> str:
    """Why the guard lets less through, from MotionLimits' `reason`."""
    return f"slowed by the guard ({reason})" if reason else ""


def robot_line(robot: dict[str, Any]) -> str:
    """The robot in one line."""
    if "mode" not in robot:
        return "robot: not heard yet"
    words = [f"robot: {robot['mode']}"]
    if robot["estop"]:
        words.append(f"E-STOP ({robot['estop_cause']})")
    elif why := held(robot["hold"]):
        words.append(why)
    if robot["cause"] and not any(robot["cause"] in word for word in words):
        words[0] += f" ({robot['cause']})"
    if "x" in robot:
        place = f"at {robot['x']:.2f} {robot['y']:.2f} yaw {robot['yaw'] * 57.29578:.0f} deg"
        old = robot["pose_age"] > POSE_AGE
        words += [f"{robot['pose_age']:.0f} s ago {place}"] if old else [place, f"{robot['speed']:.2f} m/s"]
    if robot.get("localization", "good") != "good":
        words.append(f"localization {robot['localization']}: {robot['localization_reason']}")
    if robot.get("calibration"):
        words.append(f"CALIBRATION: {robot['calibration']}")
    words += clocks(robot.get("lidars", {}))
    if robot.get("location"):
        words.append(robot["location"])
    if robot.get("warning"):
        words.append(robot["warning"])
    if robot.get("map_warning"):
        words.append(f"MAP: {robot['map_warning']}")
    words.append(f"real-time factor {robot['realtime_factor']:.2f}")
    return ", ".join(words)


def clocks(lidars: dict[str, Any]) -> list[str]:
    """Which LiDARs' stamps are corrected, from the status' `lidars`."""
    return [
        f"stamps of the {name} LiDAR corrected by {1e3 * lidar['applied']:+.1f} ms"
        for name, lidar in lidars.items()
        if lidar["applied"]
    ]


def goal_line(robot: dict[str, Any]) -> str:
    """The goal in one line."""
    goal = robot.get("goal")
    if not goal or not goal["id"]:
        return "goal: none"
    text = f"goal: {goal['state']} ({goal['x']:.2f}, {goal['y']:.2f})"
    if goal["state"] == "moving" and not goal["detail"]:
        text += f", {goal['distance_left']:.1f} m left, {goal['replans']} replans"
    if goal["state"] == "moving" and goal.get("chance"):
        text += f", {goal['chance']}"
    why = words(goal["reason"], goal["detail"])
    return f"{text}: {why}" if why else text


def mission_line(robot: dict[str, Any]) -> str:
    """The mission in one line; empty where there was none."""
    mission = robot.get("mission")
    if not mission:
        return ""
    text = f"mission {mission['name']}".strip() + f": {mission['phase']}"
    if mission["phase"] != "finished":
        text += f", step {mission['step']} of {mission['steps']}"
    why = mission["question"] or mission["reason"]
    return f"{text}: {why}" if why else text
