"""Loops of one or more runs, found in the order in which they were driven: search, verify, agree, solve. What is not
beyond doubt is refused."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hal.rotation import wrap
from hal.types import Array
from mapping.closing.fuse import corrected, fuse
from mapping.closing.graph import PoseGraph, after, back, between
from mapping.closing.keyframes import MAP_REACH, Keyframe, Surroundings, keep, keyframes_of
from mapping.closing.recording import Recording
from mapping.closing.refine import Sweep, apart, exact
from mapping.closing.verify import DIRECTION_GAP, LEAST_LEAD, Match, Refusal, Verifier, pose_of, rivals
from mapping.elevation.config import ElevationConfig
from mapping.relocalise import ENOUGH_CERTAINTY, PriorMap, locate

RANDOM_DRIFT = np.array([0.02, 0.02, 0.03, math.radians(0.05)])
"""Of odometry by the root of a metre: x, y, z [m], yaw [rad]. In 70 m of new corridor it was 0.01, 0.13, 0.014 m and
0.16 deg off, which is a third of that; wheels that slip and impacts of simulated physics made 0.02 m in 6 m of it."""
STEADY_DRIFT = np.array([1e-6, 1e-6, 0.0005, math.radians(0.0035)])
"""What odometry is wrong by all along a run, by the metre, as `RANDOM_DRIFT`: twice the climb and half as much again
as the bend of those 70 m. Of lengths no loop tells: one of another size closes as well. Where loops may be is searched
by `RANDOM_DRIFT` alone."""
LOOP_SIGMA = np.array([0.04, 0.04, 0.04, math.radians(0.3)])
"""Of a registration: x, y, z [m], yaw [rad]. Its own error is 0.006 m and 0.05 deg; the map of a keyframe is bent by
the drift within it."""
NEXT_SIGMA = np.array([0.003, 0.003, 0.003, math.radians(0.01)])
"""Of the way to the next keyframe, measured by two sweeps: x, y, z [m], yaw [rad]."""
EXACT_SIGMA = np.array([0.01, 0.01, 0.02, math.radians(0.03)])
"""Of a loop that was measured so."""
LEAST_RISES = 30
"""Measured ways of a run from which its level is told."""
LOOP_LENGTH = 30.0
"""Driven between two keyframes of a loop, at least [m]."""
OVERLAP_RADIUS = 5.0
"""Keyframes within this of each other see much the same [m]."""
SEARCH_SIGMAS = 3.0
"""Of the odometry: so far off is searched."""
SEARCH_SLACK = (0.5, math.radians(3.0))
"""What is searched beyond that [m], [rad]."""
WIDEST_SEARCH = 15.0
"""Searched around a keyframe at most [m]: its map ends there."""
MOST_MAPS = 8
"""Maps in which one keyframe is searched, the nearest ones."""
ODOMETRY_GATE = 18.5
"""Square of the distance from what odometry says, by its covariance: one right loop of a thousand is further (chi
square, 4)."""
SUPPORT_LENGTH = 40.0
"""Two loops speak for each other where odometry between them is no longer than this [m]."""
LOST_SAY = 0.2
"""A loop that keeps less of its weight than this contradicts the others: by six standard deviations."""
TOUR_SPACING = 0.5
"""Scans so far apart [m] make the map in which a further run is searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A loop that was closed."""

    match: Match
    off: Array
    """(4,) the graph less the match: x, y, z [m], yaw [rad]."""
    weight: float
    """What it kept of its say [0..1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """What became of the runs."""

    keyframes: list[Keyframe]
    nodes: Array
    """(n, 4) of the ground under each keyframe in `map`: x, y, z [m], yaw [rad]."""
    driven: Array
    """(n, 4) the same by odometry alone; of further runs from where their first keyframe was put."""
    loops: list[Loop]
    refused: list[Refusal]
    lost: list[int]
    """Runs of which no keyframe was found in those before: they are not in the map."""
    stretch: float
    """Farthest that the graph moved a step of odometry [standard deviations]."""


class Closing:
    """Finds the loops of a recording. Same recording, same loops."""

    def __init__(
        self, recording: Recording, params: ElevationConfig, origin: Array, drift: float = 1.0
    ) -> None:
        """origin (4,): x, y, z [m], yaw [rad] of the first run's `odom` in `map`. drift: how many times more than
        `RANDOM_DRIFT` and `STEADY_DRIFT` the odometry drifts."""
        self._recording, self._params = recording, params
        self._drift, self._steady = drift * RANDOM_DRIFT, drift * STEADY_DRIFT
        self._origin = origin
        self.keyframes: list[Keyframe] = []
        self._around = Surroundings(recording, params)
        self._verifier = Verifier(self.keyframes, self._around)
        self.graph = PoseGraph()
        """By odometry and loops; where loops may be is searched by it."""
        self.matches: list[Match] = []
        """Of the loops of the graph, in its order."""
        self.refused: list[Refusal] = []
        self._waiting: list[Match] = []
        self._tried: set[tuple[int, int]] = set()
        self._asked: set[int] = set()
        """Keyframes that were searched in the whole map."""
        self._absent: set[int] = set()
        """Keyframes of further runs that were not found where the map of another run has their place."""
        self._ways: dict[int, Array | None] = {}
        """(4,) keyframes in the frames of the ones before by two sweeps, by their number; None where these do not
        agree."""
        self._exact: dict[tuple[int, int], Array | None] = {}
        """The same of loops."""
        self._sweeps: OrderedDict[int, Sweep | None] = OrderedDict()
        self._prior: tuple[int, PriorMap] | None = None
        self._found = {0}
        """Runs whose place is known."""
        self._extend()

    def _extend(self) -> None:
        """Keyframes of what was recorded since."""
        for frame in keyframes_of(self._recording.scans, self.keyframes[-1:]):
            before = self.keyframes[-1] if self.keyframes else None
            if before is None or before.run != frame.run:
                self.graph.begin(after(self._origin, frame.place) if before is None else frame.place)
            else:
                way = math.sqrt(max(frame.along - before.along, 0.1))
                self.graph.drive(
                    between(before.place, frame.place), self._drift * way, frame.along - before.along
                )
            self.keyframes.append(frame)

    def close(self, progress: Callable[[float], None] = lambda _share: None) -> Closed:
        """Twice over all keyframes: what the first time was too far off may be in reach once other loops are closed.
        Once more to measure what is known then. progress hears the share done."""
        count = len(self.keyframes)
        for n in range(2 * count):
            number = n % count
            if not any(number == match.second for match in (*self.matches, *self._waiting)):
                for _ in self._take(number):
                    pass
            progress((n + 1) / (3 * count))
        self._doubt()
        for number in range(count):
            self._measure(number)
            progress((2 * count + number + 1) / (3 * count))
        for match in self._waiting:
            self._refuse(match, "alone: no other loop near it says the same")
        return self.closed()

    def follow(self, known: int = 0) -> Iterator[Closed | None]:
        """Loops of one run that goes on, while its scans are recorded: without end, a piece of work of some tenths of a
        second at a time. What is known each time that loops were closed. A keyframe is searched once, when its
        surroundings were seen. The first `known` scans were searched before: of those nothing is
        told, and a piece is a keyframe."""
        number = 0
        searched = self._recording.scans[known - 1].along - MAP_REACH if known else -1.0
        while True:
            self._extend()
            if (
                number == len(self.keyframes)
                or self._recording.scans[-1].along < self.keyframes[number].along + MAP_REACH
            ):
                yield None
                continue
            before, new = list(self.matches), self.keyframes[number].along > searched
            for _ in self._take(number):
                if new:
                    yield None
            number += 1
            yield None
            if new and self.matches != before:
                for each in range(len(self.keyframes)):
                    if self._measure(each):
                        yield None
                yield self.closed()

    def closed(self) -> Closed:
        """What is known so far: what the graph says when it knows what sweeps measured, too."""
        graph = self._measured()
        weights = graph.solve(self._steady) if len(self.keyframes) else np.empty(0)
        edges = graph.loops
        off = edges.errors(graph.nodes) * edges.sigma
        loops = [
            Loop(
                match
                if (found := self._exact.get((match.first, match.second))) is None
                else replace(match, relative=found),
                one,
                float(weight),
            )
            for match, one, weight in zip(self.matches, off, weights, strict=True)
        ]
        runs = {frame.run for frame in self.keyframes}
        return Closed(
            list(self.keyframes),
            graph.nodes,
            self._by_odometry(graph.nodes),
            loops,
            list(self.refused),
            sorted(runs - self._found),
            float(np.abs(graph.odometry.errors(graph.nodes)).max(initial=0.0)),
        )

    def _measure(self, number: int) -> bool:
        """The way to a keyframe, and its loops, by sweeps that are laid onto each other. Returns whether there was
        anything to do."""
        frame, did = self.keyframes[number], False
        before = self.keyframes[number - 1] if number else None
        if before is not None and before.run == frame.run and number not in self._ways:
            edge = number - 1 - frame.run
            way = self.graph.odometry
            said, sigma = way.relative[edge], way.sigma[edge]
            found, did = exact(self._sweep(before), self._sweep(frame), said), True
            near = found is not None and (apart(found, said) < SEARCH_SIGMAS * sigma).all()
            self._ways[number] = found if near else None
        for match in self.matches:
            loop = match.first, match.second
            if match.second == number and loop not in self._exact:
                first = self.keyframes[match.first]
                found, did = exact(self._sweep(first), self._sweep(frame), match.relative), True
                near = found is not None and (apart(found, match.relative) < DIRECTION_GAP).all()
                self._exact[loop] = found if near else None
        return did

    def _measured(self) -> PoseGraph:
        """The graph with what sweeps measured. A level that is wrong makes heights by sweeps rise in one direction, or
        by the metre: the way by odometry and loops tells how much."""
        graph, frames = self.graph.copy(), self.keyframes
        way = graph.odometry
        ways = {number: found for number, found in self._ways.items() if found is not None}
        for number, found in ways.items():
            edge = number - 1 - frames[number].run
            flat = np.array([*found[:2], way.relative[edge, 2], found[3]])
            graph.measure(edge, flat, np.where([1, 1, 0, 1], NEXT_SIGMA, way.sigma[edge]), loop=False)
        for n, match in enumerate(self.matches):
            if (there := self._exact.get((match.first, match.second))) is not None:
                graph.measure(n, there, EXACT_SIGMA, loop=True)
        if len(frames):
            graph.solve(self._steady)
        way, heights = graph.odometry, graph.nodes[:, 2]
        for run in {frame.run for frame in frames}:
            end = np.array([n for n in sorted(ways) if frames[n].run == run], np.int64)
            if len(end) < LEAST_RISES:
                continue
            rise = np.array([ways[n][2] for n in end.tolist()])
            far = np.array([frames[n].place[:2] - frames[n - 1].place[:2] for n in end])
            wrong = np.column_stack([far, [frames[n].along - frames[n - 1].along for n in end]])
            rise -= wrong @ np.linalg.lstsq(wrong, rise - (heights[end] - heights[end - 1]), rcond=None)[0]
            for edge, z in zip((end - 1 - run).tolist(), rise.tolist(), strict=True):
                graph.measure(
                    edge, [*way.relative[edge, :2], z, way.relative[edge, 3]], NEXT_SIGMA, loop=False
                )
        return graph

    def _sweep(self, frame: Keyframe) -> Sweep | None:
        if frame.scan not in self._sweeps:
            keep(self._sweeps, frame.scan, Sweep.of(self._recording, frame))
        self._sweeps.move_to_end(frame.scan)
        return self._sweeps[frame.scan]

    def _by_odometry(self, nodes: Array) -> Array:
        out = np.empty((len(self.keyframes), 4))
        first = 0
        for k, frame in enumerate(self.keyframes):
            if frame.run != self.keyframes[first].run:
                first = k
            out[k] = after(nodes[first], between(self.keyframes[first].place, frame.place))
        return out

    def _take(self, second: int) -> Iterator[None]:
        """Search one keyframe in the maps of those before it, one at a time."""
        found: list[Match] = []
        searched: list[int] = []
        for first, near, radius, turn in self._candidates(second):
            if (first, second) in self._tried:
                continue
            self._tried.add((first, second))
            candidates = self._verifier.search(first, second, near, radius, turn)
            if candidates is None:
                self.refused.append(Refusal(first, second, "open ground: too little stands around"))
                continue
            searched.append(first)
            yield
            found += [Match(first, second, pose_of(c.place), c.certainty) for c in candidates]
        if not searched:
            return
        if not found or max(match.certainty for match in found) < ENOUGH_CERTAINTY:
            most = max((match.certainty for match in found), default=0.0)
            if any(self.keyframes[first].run != self.keyframes[second].run for first in searched):
                self._absent.add(second)
            self.refused.append(Refusal(searched[0], second, f"not there: {most:.0%} certain at best", most))
            return
        best, rival = rivals(self.graph.nodes, found)
        if rival is not None and best.certainty - rival.certainty < LEAST_LEAD:
            apart = between(
                after(self.graph.nodes[rival.first], rival.relative),
                after(self.graph.nodes[best.first], best.relative),
            )
            self._refuse(
                best,
                f"looks alike: a place {np.linalg.norm(apart[:3]):.1f} m away is {rival.certainty:.0%} certain",
            )
        elif (off := self._from_odometry(best)) > ODOMETRY_GATE:
            self._refuse(best, f"too far from the odometry: {math.sqrt(off):.1f} standard deviations")
        elif why := self._verifier.check(best):
            self._refuse(best, why)
        else:
            self._agree(best)

    def _refuse(self, match: Match, why: str) -> None:
        self.refused.append(Refusal(match.first, match.second, why, match.certainty))

    def _candidates(self, second: int) -> list[tuple[int, Array, float, float]]:
        """Keyframes in whose maps it may be found, the nearest first: number, where (4,), within which radius [m] and
        turn [rad]."""
        frame = self.keyframes[second]
        if frame.run not in self._found:
            return self._anywhere(second)
        out = []
        far = np.linalg.norm(self.graph.nodes[:, :2] - self.graph.nodes[second, :2], axis=1)
        for first in np.argsort(far[:second], kind="stable"):
            other = self.keyframes[first]
            if far[first] > OVERLAP_RADIUS + WIDEST_SEARCH:
                break
            if other.run not in self._found or (
                other.run == frame.run and frame.along - other.along < LOOP_LENGTH
            ):
                continue
            near, covariance = self.graph.apart(int(first), second)
            radius = SEARCH_SIGMAS * math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
            height, turn = (SEARCH_SIGMAS * math.sqrt(max(covariance[k, k], 0.0)) for k in (2, 3))
            if far[first] < OVERLAP_RADIUS + radius and abs(near[2]) < 1.0 + height:
                out.append(
                    (
                        int(first),
                        near,
                        min(radius + SEARCH_SLACK[0], WIDEST_SEARCH),
                        min(turn + SEARCH_SLACK[1], math.pi),
                    )
                )
            if len(out) == MOST_MAPS:
                break
        return out

    def _anywhere(self, second: int) -> list[tuple[int, Array, float, float]]:
        """The same of a run whose place is not known: the relocaliser searches the whole map of the runs before."""
        run = self.keyframes[second].run
        if second in self._asked:
            return []
        self._asked.add(second)
        if self._prior is None or self._prior[0] != run:
            self._prior = run, self._map_before(run)
        verdict = locate(self._prior[1], self._around.submap(self.keyframes[second]))
        if verdict.answer != "located":
            self.refused.append(
                Refusal(second, second, f"searched in all runs before: {verdict.answer.replace('_', ' ')}")
            )
            return []
        place = pose_of(verdict.candidates[0].place)
        known = [k for k, frame in enumerate(self.keyframes) if frame.run in self._found]
        first = min(known, key=lambda k: float(np.linalg.norm(self.graph.nodes[k, :3] - place[:3])))
        if np.linalg.norm(self.graph.nodes[first, :3] - place[:3]) > OVERLAP_RADIUS:
            self.refused.append(Refusal(first, second, "found where no keyframe is near"))
            return []
        return [(first, between(self.graph.nodes[first], place), *SEARCH_SLACK)]

    def _map_before(self, run: int) -> PriorMap:
        scans = self._recording.scans
        poses = corrected(scans, self.keyframes, self.graph.nodes)
        chosen: list[int] = []
        for n, scan in enumerate(scans):
            last = scans[chosen[-1]] if chosen else None
            if (
                scan.run in self._found
                and scan.run < run
                and (last is None or last.run != scan.run or scan.along - last.along >= TOUR_SPACING)
            ):
                chosen.append(n)
        made = fuse(self._recording, poses, self._params, chosen)
        for n in chosen:
            for _, points in self._recording.points(scans[n]):
                made.cloud.add(points, poses[n, :3, :3], poses[n, :3, 3])
        return PriorMap(made.cloud.points, [made.read(box).grid() for box in made.boxes()])

    def _from_odometry(self, match: Match) -> float:
        """Square of the distance between a match and what the graph says, by the covariance of both."""
        said, covariance = self.graph.apart(match.first, match.second)
        off = match.relative - said
        off[3] = wrap(off[3])
        return float(off @ np.linalg.solve(covariance + np.diag(LOOP_SIGMA**2), off))

    def _agree(self, match: Match) -> None:
        """Close it where another loop near it says the same; until then it waits."""
        others = [other for other in (*self.matches, *self._waiting) if self._say_the_same(other, match)]
        if not others:
            self._waiting.append(match)
            return
        for new in (*(other for other in others if other in self._waiting), match):
            self._enter(new)
        self._waiting = [other for other in self._waiting if other not in others]
        self._solve()

    def _say_the_same(self, a: Match, b: Match) -> bool:
        """Round both loops and the odometry between them: does the way end where it began?"""
        frames = self.keyframes
        ends = ((frames[a.first], frames[b.first]), (frames[a.second], frames[b.second]))
        ways = [abs(p.along - q.along) for p, q in ends]
        if any(p.run != q.run for p, q in ends) or max(ways) > SUPPORT_LENGTH or a.second == b.second:
            return False
        here, there = (between(p.place, q.place) for p, q in ends)
        round_trip = between(after(here, b.relative), after(a.relative, there))
        sigma = np.sqrt(2.0 * LOOP_SIGMA**2 + sum(ways) * self._drift**2)
        sigma[:2] = np.hypot(sigma[:2], sigma[3] * max(ways))  # a turn at one end moves the other
        return bool((np.abs(round_trip) < SEARCH_SIGMAS * sigma).all())

    def _enter(self, match: Match) -> None:
        run = self.keyframes[match.second].run
        if run not in self._found:  # its nodes are brought there first: the solver takes small steps
            self._found.add(run)
            target = after(self.graph.nodes[match.first], match.relative)
            home = after(target, back(self.graph.nodes[match.second]))
            own = [k for k, frame in enumerate(self.keyframes) if frame.run == run]
            self.graph.nodes[own] = after(np.tile(home, (len(own), 1)), self.graph.nodes[own])
        self.graph.close(match.first, match.second, match.relative, LOOP_SIGMA)
        self.matches.append(match)

    def _solve(self) -> None:
        """Solve; the loop that contradicts the others most goes, and again."""
        weights = self.graph.solve()
        while len(weights) and weights.min() < LOST_SAY:
            worst = int(weights.argmin())
            self._refuse(
                self.matches[worst], f"contradicts the others: it kept {weights[worst]:.0%} of its say"
            )
            self.graph.drop({worst})
            del self.matches[worst]
            weights = self.graph.solve()
        self._reach()

    def _doubt(self) -> None:
        """A run of which as many keyframes are missed as are found is elsewhere: two places may look alike, a way
        through them does not."""
        for run in sorted(self._found - {0}):
            loops = {
                n
                for n, match in enumerate(self.matches)
                if self.keyframes[match.second].run == run and self.keyframes[match.first].run != run
            }
            there = {self.matches[n].second for n in loops}
            absent = {k for k in self._absent if self.keyframes[k].run == run} - there
            if loops and len(absent) >= len(there):
                for n in loops:
                    self._refuse(
                        self.matches[n],
                        f"elsewhere: of run {run + 1} {len(there)} keyframes are there and {len(absent)} are not",
                    )
                self.graph.drop(loops)
                self.matches = [match for n, match in enumerate(self.matches) if n not in loops]
        self._reach()

    def _reach(self) -> None:
        """Which runs hang together with the first one."""
        runs = [tuple(self.keyframes[k].run for k in (match.first, match.second)) for match in self.matches]
        self._found = {0}
        for first, second in sorted(runs):
            if first in self._found:
                self._found.add(second)
