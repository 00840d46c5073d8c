# SPDX-License-Identifier: MIT
"""Written plans as whoever receives them reads and follows them. Shares no code with the package.

Readers of the three formats; the rules by which ROS 2's joint_trajectory_controller validates and
interpolates a trajectory (its documentation, "Trajectory Representation"); a controller that runs
TP programs as even joint moves.
"""

import csv
import json
import math
import re
from dataclasses import dataclass

import mujoco
import numpy as np

RULES = "linear", "cubic", "quintic"
"""By what is given of each point: positions, velocities too, accelerations too."""


@dataclass
class Received:
    """A trajectory as it was read: angles in rad, ways in m, times in s."""

    names: list
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    gripper: list
    """What the gripper was told last, at each point."""


def read_json(path) -> Received:
    found = json.loads(path.read_text())
    points = found["points"]
    states = []
    for number in range(len(points)):
        told = [event["command"] for event in found["gripper"] if event["point"] <= number]
        states.append(told[-1] if told else "")
    for event in found["gripper"]:
        assert event["time_from_start"] == points[event["point"]]["time_from_start"]
    assert set(found["joint_units"]) <= {"rad", "m"}
    columns = [
        np.array([p[k] for p in points])
        for k in ("time_from_start", "positions", "velocities", "accelerations")
    ]
    return Received(found["joint_names"], *columns, states)


def read_csv(path) -> Received:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    known = {"time_from_start", "source", "gripper"}
    names = [k for k in rows[0] if k not in known and not re.search("_(velocity|acceleration)$", k)]
    columns = [
        np.array([[float(row[name + kind]) for name in names] for row in rows])
        for kind in ("", "_velocity", "_acceleration")
    ]
    times = np.array([float(row["time_from_start"]) for row in rows])
    return Received(names, times, *columns, [row["gripper"] for row in rows])


def ros2_faults(received: Received, names) -> list[str]:
    """What the controller refuses a goal for."""
    faults = []
    if sorted(received.names) != sorted(names):
        faults.append("joint names")
    if not (np.diff(received.times) > 0).all() or received.times[0] < 0:
        faults.append("times do not grow strictly")
    if np.abs(received.v[-1]).max() > np.finfo(np.float32).eps:
        faults.append("velocity at the end")
    if not all(np.isfinite(a).all() for a in (received.times, received.q, received.v, received.a)):
        faults.append("not finite")
    return faults


def interpolate(received: Received, rule: str, at: np.ndarray):
    """Positions, velocities and accelerations `[time, joint]` between the points, by a rule."""
    t = received.times
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    h = (t[i + 1] - t[i])[:, None]
    s = (at - t[i])[:, None]
    (p0, p1), (v0, v1), (a0, a1) = ((c[i], c[i + 1]) for c in (received.q, received.v, received.a))
    if rule == "linear":
        c = [p0, (p1 - p0) / h]
    elif rule == "cubic":
        c = [p0, v0, (3 * (p1 - p0) / h - 2 * v0 - v1) / h, (2 * (p0 - p1) / h + v0 + v1) / h**2]
    else:
        d = p1 - p0
        c = [
            p0,
            v0,
            a0 / 2,
            (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h**2) / (2 * h**3),
            (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h**2) / (2 * h**4),
            (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h**2) / (2 * h**5),
        ]
    found = []
    for order in range(3):
        total = np.zeros_like(p0)
        for power in range(order, len(c)):
            total = total + math.perm(power, order) * c[power] * s ** (power - order)
        found.append(total)
    return found


@dataclass
class Move:
    """What a controller of TP programs does next."""

    kind: str
    """move, wait or tell."""
    seconds: float = math.nan
    q: np.ndarray | None = None
    told: str = ""


def read_tp(path, minus=()) -> list[Move]:
    """A TP program as moves; `minus` are pairs of J numbers counted from each other, from 0."""
    text = path.read_text()
    body, places = text.split("/MN\n")[1].split("/POS\n")
    positions = {}
    for number, block in re.findall(r"P\[(\d+)\]\{(.*?)\};", places, re.DOTALL):
        angles = [math.radians(float(x)) for x in re.findall(r"J\d+=\s*(\S+) deg", block)]
        for one, other in minus:
            angles[one] += angles[other]
        ways = [float(x) / 1e3 for x in re.findall(r"E\d+=\s*(\S+) mm", block)]
        positions[int(number)] = angles, ways
    moves = []
    for line in body.splitlines():
        instruction = line.split(":", 1)[1].strip().rstrip(";").strip()
        if found := re.fullmatch(r"J P\[(\d+)\] (\d+)(msec|%) (FINE|CNT100)", instruction):
            angles, ways = positions[int(found[1])]
            seconds = int(found[2]) / 1e3 if found[3] == "msec" else math.nan
            moves.append(Move("move", seconds, (angles, ways)))
        elif found := re.fullmatch(r"WAIT\s+(\S+)\(sec\)", instruction):
            moves.append(Move("wait", float(found[1])))
        else:
            moves.append(Move("tell", told=instruction))
    return moves


def in_order(axes, units) -> np.ndarray:
    """Joint values in the arm's order from (angles, ways)."""
    angles, ways = map(iter, axes)
    return np.array([next(ways if unit == "m" else angles) for unit in units])


class Tool:
    """Where C MuJoCo sees the tool of an arm."""

    def __init__(self, model, qpos_addresses, site):
        self.model, self.data = model, mujoco.MjData(model)
        self.addresses, self.site = list(qpos_addresses), site

    def __call__(self, q: np.ndarray) -> np.ndarray:
        """Positions `[row, 3]` [m]."""
        found = np.empty((len(q), 3))
        for row, values in zip(found, q, strict=True):
            self.data.qpos[self.addresses] = values
            mujoco.mj_kinematics(self.model, self.data)
            row[:] = self.data.site_xpos[self.site]
        return found
