"""`/diagnostics` (diagnostic_msgs): what `status` knows, in the form that ROS tools show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hal.types import Phase
from rbtrg_robot.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rbtrg_robot.wire.messages import header

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)
SILENT_AFTER = 2.0
"""A process without a heartbeat for this long [s] says nothing of the present."""
FAILED = ("rejected", "aborted")
"""States of a goal that was not reached for a reason of its own."""
SNMP = Path("/proc/net/snmp")


class Diagnosis:
    """Makes one DiagnosticArray a second. It remembers only the counter of lost datagrams."""

    def __init__(self, robot: str) -> None:
        """`robot`: its name, the hardware_id of every entry."""
        self._robot = robot
        self._lost: int | None = None

    def message(self, status: dict[str, Any], stamp: int) -> DiagnosticArray:
        """From what `status --json` prints; `stamp` [ns, source clock]."""
        fresh = {row["process"] for row in status["processes"] if _beats(row)}
        entries = [self._stack(status), *(self._process(row) for row in status["processes"])]
        entries.append(self._topics(status["topics"]))
        for made, owner in (
            (self._body, "robot"),
            (self._odometry, "odometry"),
            (self._map, "elevation"),
            (self._goal, "navigator"),
            (self._tracker, "tracker"),
            (self._mission, "mission"),
        ):
            entry = made(status["robot"])
            if owner not in fresh:
                entry.level, entry.message = STALE, f"the {owner} process is silent; {entry.message}"
            entries.append(entry)
        entries.append(self._network())
        return DiagnosticArray(header=header(stamp, ""), status=entries)

    def _entry(self, name: str, level: int, words: str, /, **values: Any) -> DiagnosticStatus:
        pairs = [KeyValue(key=key, value="" if v is None else str(v)) for key, v in values.items()]
        return DiagnosticStatus(
            level=level, name=f"rbtrg: {name}", message=words, hardware_id=self._robot, values=pairs
        )

    def _stack(self, status: dict[str, Any]) -> DiagnosticStatus:
        values = {k: status[k] for k in ("version", "pid", "uptime", "log_dir", "refused")}
        ready = status["ready"]
        return self._entry("stack", OK if ready else WARN, "ready" if ready else "not ready yet", **values)

    def _process(self, row: dict[str, Any]) -> DiagnosticStatus:
        level = OK if row["state"] == "ready" else ERROR if row["state"].startswith("failed") else WARN
        if level == OK and not _beats(row):
            level = STALE
        values = {
            k: row[k]
            for k in ("pid", "restarts", "cpu", "memory_mb", "heartbeat_age", "dropped", "refused", "detail")
        }
        return self._entry(f"process {row['process']}", level, row["state"], **values)

    def _topics(self, rows: list[dict[str, Any]]) -> DiagnosticStatus:
        timed = [row for row in rows if row["nominal"]]
        bad = [row["topic"] for row in timed if row["ok"] is False]
        words = f"too slow: {', '.join(bad)}" if bad else "all rates are well"
        rates = {row["topic"]: f"{row['rate']:.1f} of {row['nominal']:g} Hz" for row in timed}
        return self._entry("topics", WARN if bad else OK, words, **rates)

    def _body(self, robot: dict[str, Any]) -> DiagnosticStatus:
        if "mode" not in robot:
            return self._entry("robot", STALE, "not heard yet")
        level = OK
        if robot["estop"] or robot["mode"] not in {
            Phase.READY.value,
            Phase.MOVING.value,
            Phase.STANDING.value,
            Phase.SITTING.value,
        }:
            level = WARN
        if robot["mode"] in {Phase.FAULT.value, Phase.DISCONNECTED.value}:
            level = ERROR
        values = {
            k: robot[k] for k in ("cause", "estop", "estop_cause", "hold", "battery", "realtime_factor")
        }
        refused = {f"refused: {reason}": count for reason, count in robot["refused"].items()}
        advice = {f"advice: {monitor}": remedy for monitor, remedy in robot["advice"].items()}
        return self._entry("robot", level, robot["mode"], **values, **refused, **advice)

    def _odometry(self, robot: dict[str, Any]) -> DiagnosticStatus:
        health = robot.get("localization")
        if health is None:
            return self._entry("odometry", STALE, "not heard yet")
        level = {"good": OK, "degraded": WARN}.get(health, ERROR)
        motion = ("x", "y", "z", "yaw", "speed", "yaw_rate", "pose_age")
        values: dict[str, Any] = {k: robot[k] for k in motion if k in robot}
        for name, lidar in robot["lidars"].items():
            for key, seconds in lidar.items():
                values[f"{name} {key} [ms]"] = f"{1e3 * seconds:.2f}"
        if robot["calibration"]:
            level = max(level, WARN)
        words = "; ".join(filter(None, (robot["localization_reason"], robot["calibration"])))
        return self._entry("odometry", level, f"{health}: {words}" if words else health, **values)

    def _map(self, robot: dict[str, Any]) -> DiagnosticStatus:
        warning = robot.get("map_warning")
        if warning is None:
            return self._entry("map", STALE, "not heard yet")
        return self._entry("map", WARN if warning else OK, warning or "well", location=robot["location"])

    def _goal(self, robot: dict[str, Any]) -> DiagnosticStatus:
        goal = robot.get("goal")
        if goal is None:
            return self._entry("goal", STALE, "not heard yet")
        words = ": ".join(filter(None, (goal["state"], goal["reason"], goal["detail"]))) or "none"
        return self._entry("goal", WARN if goal["state"] in FAILED else OK, words, **goal)

    def _tracker(self, robot: dict[str, Any]) -> DiagnosticStatus:
        if "tracker" not in robot:
            return self._entry("tracker", STALE, "not heard yet")
        hold, slow = robot["tracker_hold"], robot["tracker_slow"]
        words = ": ".join(filter(None, (robot["tracker"], hold)))
        return self._entry("tracker", WARN if hold else OK, words, hold=hold, slow=slow)

    def _mission(self, robot: dict[str, Any]) -> DiagnosticStatus:
        mission = robot.get("mission")
        if mission is None:
            return self._entry("mission", OK, "none")
        words = ": ".join(filter(None, (mission["phase"], mission["reason"], mission["question"])))
        return self._entry("mission", OK, words, **mission)

    def _network(self) -> DiagnosticStatus:
        """Datagrams that this computer lost because a receive buffer was full, of all programs, since it was switched
        on."""
        lost = receive_errors()
        if lost is None:
            return self._entry("network", STALE, f"{SNMP} cannot be read")
        new = lost - self._lost if self._lost is not None else 0
        self._lost = lost
        words = (
            f"{new} datagrams lost in the last second: raise net.core.rmem_max" if new > 0 else "nothing lost"
        )
        return self._entry("network", WARN if new > 0 else OK, words, udp_receive_buffer_errors=lost)


def _beats(row: dict[str, Any]) -> bool:
    return (
        row["state"] == "ready" and row["heartbeat_age"] is not None and row["heartbeat_age"] < SILENT_AFTER
    )


def receive_errors() -> int | None:
    """RcvbufErrors of UDP in /proc/net/snmp; None where it cannot be read."""
    try:
        names, values = (line.split() for line in SNMP.read_text().splitlines() if line.startswith("Udp:"))
        return int(values[names.index("RcvbufErrors")])
    except (OSError, ValueError):
        return None
