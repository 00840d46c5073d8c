# SPDX-License-Identifier: MIT
"""How far a written plan is from what was planned, for whoever receives the file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from controllers import (
    RULES,
    Received,
    Tool,
    in_order,
    interpolate,
    read_csv,
    read_json,
    read_tp,
    ros2_faults,
)
from random_plans import CLOSE, OPEN

from hybrid_jax.export import write_plan

PAUSE = 0.8
"""Rest in which the gripper moves, as the documents say [s]."""
SLACK = 1.01
"""On limits, as of the final check."""


@dataclass
class Departures:
    """Of one plan, or the worst of many."""

    joint: float = 0.0
    """Of joint values at the points of a file [rad or m]."""
    tool: float = 0.0
    """Of the tool between them [m]."""
    gripper: int = 0
    """Points with a wrong gripper state."""
    limits: int = 0
    """Times at which a limit is exceeded."""
    refused: int = 0
    """Files that ROS 2 refuses."""

    def add(self, other: "Departures") -> None:
        self.joint, self.tool = max(self.joint, other.joint), max(self.tool, other.tool)
        self.gripper += other.gripper
        self.limits += other.limits
        self.refused += other.refused


class Wanted:
    """A plan on one clock, put together anew from its phases."""

    def __init__(self, task, phases):
        held = [bool(task.carrying[low]) for low, _ in task.phases]
        grips, begin, columns = any(task.carrying), 0.0, ([], [], [], [])
        self.states, self.begins = [], []
        for number, phase in enumerate(phases):
            begin += PAUSE if number and grips else 0.0
            self.begins.append(begin)
            skip = int(bool(number) and not grips)  # without a rest two phases share a point
            rows = begin + phase.times, phase.positions, phase.velocities, phase.accelerations
            for column, values in zip(columns, rows, strict=True):
                column.append(values[skip:])
            now, then = ("close" if h else "open" for h in [*held, False][number : number + 2])
            self.states += [now if grips else ""] * (len(phase.times) - skip)
            self.states[-1] = then if grips else ""
            begin += float(phase.times[-1])
        self.points = Received([], *map(np.concatenate, columns), self.states)

    def at(self, times: np.ndarray) -> np.ndarray:
        """As it was checked: even motion between its points."""
        return np.stack([np.interp(times, self.points.times, c) for c in self.points.q.T], axis=1)


def table_departures(cell, wanted: Wanted, received, rng) -> Departures:
    """Of a JSON or CSV file."""
    layout, found = cell.source.layout, Departures()
    assert received.times.shape == wanted.points.times.shape
    found.joint = max(
        np.abs(received.q - wanted.points.q).max(),
        np.abs(received.times - wanted.points.times).max(),
    )
    found.gripper = sum(a != b for a, b in zip(received.gripper, wanted.states, strict=True))
    found.refused = int(bool(ros2_faults(received, cell.joint_names)))
    rests = np.flatnonzero(np.diff(received.times) > PAUSE / 2)  # the longest steps are pauses
    inside = [received.times[i] + PAUSE * np.linspace(0, 1, 40) for i in rests]
    at = np.concatenate([rng.uniform(0, received.times[-1], 400), *inside])
    tool = Tool(cell.model, layout.qpos, layout.tool_site)
    truth = tool(wanted.at(at))
    speed, rate = (
        np.asarray(a) * SLACK for a in (cell.velocity_limits, cell.chain.acceleration_limits)
    )
    for rule in RULES:
        q, velocity, acceleration = interpolate(received, rule, at)
        found.tool = max(found.tool, np.linalg.norm(tool(q) - truth, axis=1).max())
        found.limits += int((np.abs(velocity) > speed).any(axis=1).sum())
        found.limits += int((np.abs(acceleration) > rate).any(axis=1).sum())
    return found


def program_departures(cell, wanted: Wanted, moves, rng) -> Departures:
    """Of a TP program; its clock is set to a phase's beginning at each move without a time."""
    layout, found = cell.source.layout, Departures()
    runs, told = [], ""
    for move in moves:
        if move.kind == "tell":
            told = {OPEN: "open", CLOSE: "close"}.get(move.told, told)
        elif move.kind == "move":
            q = in_order(move.q, cell.joint_units)
            if np.isnan(move.seconds):
                begin = wanted.begins[len(runs)]
                first = int(np.searchsorted(wanted.points.times, begin))
                found.gripper += told != wanted.states[first]
                runs.append(([begin], [q]))
            else:
                times, rows = runs[-1]
                times.append(times[-1] + move.seconds)
                rows.append(q)
    found.gripper += told != wanted.states[-1]
    tool = Tool(cell.model, layout.qpos, layout.tool_site)
    for times, rows in map(lambda run: map(np.array, run), runs):
        away = rows - interpolate(wanted.points, "quintic", times)[0]
        found.joint = max(found.joint, np.abs(away).max())
        at = rng.uniform(times[0], times[-1], 300)
        even = np.stack([np.interp(at, times, c) for c in rows.T], axis=1)
        found.tool = max(found.tool, np.linalg.norm(tool(even) - tool(wanted.at(at)), axis=1).max())
        speeds = np.abs(np.diff(rows, axis=0)) / np.diff(times)[:, None]
        found.limits += int((speeds > SLACK * np.asarray(cell.velocity_limits)).any(axis=1).sum())
    return found


def depart(cell, task, plan, folder: Path, rng: np.random.Generator) -> dict[str, Departures]:
    """Write a plan in each format, read it back, compare."""
    wanted, found = Wanted(task, plan.phases), {}
    for ending, read in ((".json", read_json), (".csv", read_csv), (".ls", read_tp)):
        path = folder / f"plan{ending}"
        write_plan(path, cell, task, plan)
        judge = program_departures if ending == ".ls" else table_departures
        found[ending] = judge(cell, wanted, read(path), rng)
    return found
