"""What the acquisition process says about itself, twenty times a second, and how that travels as JSON."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from daq import samples
from daq.samples import Sample


class Latest(NamedTuple):
    """The newest sample of a source and its estimated run time."""

    sample: Sample
    t: float


@dataclass(frozen=True)
class PortStatus:
    """One port. Counters count from the start of the log; rates and ages are in run time."""

    name: str
    protocol: str
    port: str
    expected: float  # samples a run second, from the rig
    rate: float  # samples a run second over the last few seconds, NaN before the second sample
    age: float  # run seconds since the last sample, infinite before the first
    samples: int
    frames: int
    checksum_errors: int
    unparsed_bytes: int
    dropped: int  # samples and reads that the recorder had no room for
    reconnects: int
    bytes_in: int
    latency: float  # s, mean of receive time minus estimated sample time; NaN for a device without a clock
    latency_spread: float  # s
    message: str  # what is wrong with it, in one line; empty when nothing is


# Device and node; a device of several kinds has `DEVICE/KIND` for those behind the first.
Source = tuple[str, int | None]


@dataclass(frozen=True)
class LinkStatus:
    """What is known of the autopilot at the other end of a link."""

    heard: bool = False
    age: float = math.inf  # wall s since its last heartbeat
    armed: bool = False
    mode: str = ""
    ekf: int = -1  # flags of EKF_STATUS_REPORT; -1 before the first
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)  # those asked for that it has
    asking: bool = True  # answers to questions for parameters are still awaited
    refused: tuple[str, ...] = ()  # rates that it does not give, one line each
    answer: str = ""  # to the last wish: "arm: accepted", "arm: failed (PreArm: ...)"; empty while it is awaited
    alarm: str = ""  # the last text of severity critical or above


@dataclass(frozen=True)
class Status:
    """The whole acquisition at run time `t`."""

    t: float
    ports: dict[str, PortStatus]  # by device
    latest: dict[Source, Latest]  # by device and node; the node is None but for speed controllers
    commanded: dict[str, float]  # n_cmd by thruster, as last sent; 0 before the first command
    pending: int  # set-points that wait for their time
    path: str
    bytes: int
    messages: int  # samples written
    duration: float  # run seconds since the log was begun
    stopped: str  # why the acquisition process ended thrust by itself; empty while it has not
    warnings: tuple[str, ...]
    skipped: int = 0  # set-points that a later one overtook before they could be sent
    links: dict[str, LinkStatus] = dataclasses.field(default_factory=dict)  # by device
    hints: tuple[str, ...] = ()  # what is no fault but could be better, a line each


def to_json(status: Status) -> dict[str, Any]:
    """`status` as JSON can carry it (NaN and Infinity included, as Python's json does)."""
    out = {field.name: getattr(status, field.name) for field in dataclasses.fields(status)}
    out["ports"] = [dataclasses.asdict(port) for port in status.ports.values()]
    out["links"] = {name: dataclasses.asdict(link) for name, link in status.links.items()}
    out["latest"] = [
        [device, node, type(latest.sample).__name__, dataclasses.astuple(latest.sample), latest.t]
        for (device, node), latest in status.latest.items()
    ]
    return out


def from_json(data: dict[str, Any]) -> Status:
    """The inverse of `to_json`."""
    ports = {port["name"]: PortStatus(**port) for port in data["ports"]}
    latest: dict[Source, Latest] = {}
    for device, node, kind, values, t in data["latest"]:
        latest[device, node] = Latest(getattr(samples, kind)(*values), t)
    links = {name: LinkStatus(**{**link, "refused": tuple(link["refused"])}) for name, link in data["links"].items()}
    lines = {"warnings": tuple(data["warnings"]), "hints": tuple(data["hints"])}
    return Status(**{**data, **lines, "links": links, "ports": ports, "latest": latest})


class RateMeter:
    """Events a second from a counter that is looked at now and then."""

    def __init__(self, window: float) -> None:
        self._window = window
        self._seen: list[tuple[float, int]] = []

    def rate(self, t: float, count: int) -> float:
        """Rate over the last window [1/s] when `count` has been reached at `t`; NaN until it has grown."""
        if count == 0:
            return math.nan
        self._seen.append((t, count))
        while len(self._seen) > 2 and self._seen[1][0] <= t - self._window:
            del self._seen[0]
        t_0, count_0 = self._seen[0]
        if count == count_0 and t - t_0 < self._window:
            return math.nan
        return (count - count_0) / (t - t_0) if t > t_0 else math.nan
