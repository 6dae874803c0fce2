"""Missions as GeoJSON (RFC 7946), to be drawn and looked at in map tools.

A step is a feature in the mission's order: `goto` a Point, every other one without a geometry, its settings in
`properties` as in the mission file. Without an origin the coordinates are metres in frame `map` and the collection
says so (`frame`), which GIS tools show on a plane; with one they are longitude and latitude."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal.regular import open_regular
from rbtrg_robot.missions.file import MissionError, MissionFile, parse
from rbtrg_robot.yaml_file import LARGEST_FILE

EQUATOR_RADIUS = 6378137.0
"""Semi-major axis of WGS 84 [m]."""
ECCENTRICITY_SQUARED = 6.69437999014e-3
"""Its first eccentricity, squared."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the origin of `map` lies on the Earth."""

    latitude: float
    """[deg]"""
    longitude: float
    """[deg]"""
    yaw: float
    """From east to the x axis of `map`, counterclockwise [rad]."""

    def _radii(self) -> tuple[float, float]:
        """Of the meridian and, times the cosine of the latitude, of the parallel [m]."""
        s = math.sin(math.radians(self.latitude))
        w = 1.0 - ECCENTRICITY_SQUARED * s * s
        parallel = EQUATOR_RADIUS / math.sqrt(w) * math.cos(math.radians(self.latitude))
        return EQUATOR_RADIUS * (1.0 - ECCENTRICITY_SQUARED) / w**1.5, parallel

    def to_earth(self, x: float, y: float) -> tuple[float, float]:
        """Longitude and latitude [deg] of a place in `map` [m]; 2 cm off at 500 m, as the ellipsoid is taken as flat
        here."""
        meridian, parallel = self._radii()
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        east, north = c * x - s * y, s * x + c * y
        return self.longitude + math.degrees(east / parallel), self.latitude + math.degrees(north / meridian)

    def to_map(self, longitude: float, latitude: float) -> tuple[float, float]:
        """Inverse of `to_earth`."""
        meridian, parallel = self._radii()
        east = math.radians(math.remainder(longitude - self.longitude, 360.0)) * parallel
        north = math.radians(latitude - self.latitude) * meridian
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return c * east + s * north, c * north - s * east


def to_geojson(mission: MissionFile, origin: Origin | None = None) -> dict[str, Any]:
    """A FeatureCollection; `loops` and the settings of the mission are members of their own."""
    features: list[dict[str, Any]] = []
    loops: list[dict[str, Any]] = []
    values = mission.model_dump(mode="json", exclude_defaults=True)
    _flatten(values.pop("steps"), features, loops, origin)
    frame = {} if origin else {"frame": mission.frame}
    return {
        "type": "FeatureCollection",
        **frame,
        "mission": values,
        "loops": loops,
        "features": features,
    }


def _flatten(
    tree: list[Any], features: list[dict[str, Any]], loops: list[dict[str, Any]], origin: Origin | None
) -> None:
    for node in tree:
        if isinstance(node, dict) and "loop" in node:
            loop = {"first": len(features) + 1, "last": 0, "times": node["loop"]["times"]}
            loops.append(loop)
            _flatten(node["loop"]["steps"], features, loops, origin)
            loop["last"] = len(features)
            continue
        properties: dict[str, Any] = (
            dict(node) if isinstance(node, dict) else {"home": {}} if node == "home" else {"posture": node}
        )
        geometry = None
        if "goto" in properties:
            place = dict(properties["goto"])
            x, y = place.pop("x"), place.pop("y")
            geometry = {"type": "Point", "coordinates": list(origin.to_earth(x, y)) if origin else [x, y]}
            properties["goto"] = place
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})


def from_geojson(content: Any, what: str, origin: Origin | None = None) -> MissionFile:
    """The mission in a FeatureCollection: ours, or one that was drawn, where points and the corners of lines become
    `goto`.

    Raises MissionError; `what` names the file in it. Headings that a tool adds to a point as `yaw_deg` count."""
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise MissionError(f"{what} is no GeoJSON FeatureCollection")
    if origin is None and content.get("frame") != "map":
        raise MissionError(f"{what} has longitudes and latitudes: tell where `map` lies with --origin")
    if origin is not None and "frame" in content:
        raise MissionError(f"{what} has metres in frame {content['frame']}: leave --origin out")
    flat: list[dict[str, Any]] = []
    try:
        for feature in content["features"]:
            flat += _steps(feature, origin)
        spans = [(loop["first"], loop["last"], loop["times"]) for loop in content.get("loops", ())]
        steps, used = _nest(flat, spans, 1, len(flat), 0)
        if used < len(spans):
            raise ValueError(f"loop {used + 1} lies in no steps")
        mission = {**content.get("mission", {}), "steps": steps}
    except (
        KeyError,
        TypeError,
        ValueError,
        IndexError,
        AttributeError,
        ArithmeticError,
        RecursionError,
    ) as error:
        raise MissionError(f"{what} is no mission: {type(error).__name__} at {error}") from error
    return parse(mission, what)


def _steps(feature: dict[str, Any], origin: Origin | None) -> list[dict[str, Any]]:
    geometry, properties = feature.get("geometry"), feature.get("properties") or {}
    if geometry is None:
        return [properties]
    kind, coordinates = geometry["type"], geometry["coordinates"]
    if kind not in ("Point", "LineString"):
        raise ValueError(f"a {kind}: only points and lines can be driven to")
    places = [coordinates] if kind == "Point" else coordinates
    steps = []
    for place in places:
        x, y = origin.to_map(place[0], place[1]) if origin else (float(place[0]), float(place[1]))
        ours = isinstance(properties.get("goto"), dict)
        step = dict(properties) if ours else {}
        heading = {"yaw_deg": properties["yaw_deg"]} if properties.get("yaw_deg") is not None else {}
        step["goto"] = {"x": x, "y": y, **(properties["goto"] if ours else heading)}
        steps.append(step)
    return steps


def _nest(
    flat: list[dict[str, Any]], spans: list[tuple[int, int, Any]], first: int, last: int, k: int
) -> tuple[list[Any], int]:
    """Steps `first` to `last` with the loops from number `k` on that lie in them; the number of the next loop."""
    steps: list[Any] = []
    at = first
    while at <= last:
        if k < len(spans) and spans[k][0] == at <= spans[k][1] <= last:
            _, end, times = spans[k]
            inner, k = _nest(flat, spans, at, end, k + 1)
            steps.append({"loop": {"times": times, "steps": inner}})
            at = end + 1
        else:
            steps.append(flat[at - 1])
            at += 1
    return steps, k


def load(path: Path, origin: Origin | None = None) -> MissionFile:
    """Read a GeoJSON file. Raises MissionError."""
    try:
        with open_regular(path) as file:
            text = file.read(LARGEST_FILE + 1)
        if len(text) > LARGEST_FILE:
            raise MissionError(f"{path} has more than {LARGEST_FILE:,} bytes")
        return from_geojson(json.loads(text), str(path), origin)
    except OSError as error:
        raise MissionError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise MissionError(f"{path} is not JSON: {error}") from error
