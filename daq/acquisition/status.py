"""Status of a running acquisition: ports, newest samples, set-points, log and links. It is sent at 20 Hz."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

from seatrial.daq import samples
from seatrial.daq.drivers import LinkStatus
from seatrial.daq.samples import Sample

NO_STATUS_S = 1.0  # wall seconds without a status after which the acquisition counts as hanging; the rate is 20 Hz
# Name and node. The name is that of the device, or `DEVICE/KIND` for the further kinds of a device with several kinds.
Source = tuple[str, int | None]


class Latest(NamedTuple):
    """The newest sample of a source."""

    sample: Sample
    t: float  # its estimated run time [s]


class StreamedSample(NamedTuple):
    """A sample of a device as it is written to the log."""

    device: str  # name of the device
    sample: Sample
    t: float  # its estimated run time [s]


@dataclass(frozen=True)
class PortStatus:
    """State of one port. Counters start at the start of the log. Rates and ages refer to run time."""

    name: str  # name of the device
    protocol: str  # name of its protocol
    port: str  # device file or address
    expected: float  # samples per run second, from the rig
    rate: float  # samples per run second over the last few seconds, NaN before the second sample
    age: float  # run seconds since the last sample, infinite before the first
    samples: int  # decoded samples
    frames: int  # valid frames
    checksum_errors: int  # frames with a wrong checksum
    unparsed_bytes: int  # received bytes that belong to no valid frame
    dropped: int  # samples and reads for which the log queue had no room
    reconnects: int  # how often the port was opened again after a loss
    bytes_in: int  # received bytes
    latency: float  # s, mean of receive time minus estimated sample time; NaN for a device without a clock
    latency_spread: float  # s, standard deviation of the same difference; NaN for a device without a clock
    message: str  # fault of the port in one line, else `remark`; empty without both
    remark: str = ""  # note for the user on a stream without a fault
    stuck: tuple[str, ...] = ()  # kinds of samples that repeat the same values, as a dead sensor does
    open: bool = True  # False before the port was opened and after it was lost


@dataclass(frozen=True)
class Status:
    """State of the whole acquisition at run time `t`."""

    t: float  # run time [s]
    ports: dict[str, PortStatus]  # by device
    latest: dict[Source, Latest]  # by device and node; the node is None except for speed controllers
    commanded: dict[str, float]  # n_cmd by thruster, as last sent; 0 before the first command
    pending: int  # set-points that wait for their time
    path: str  # of the log
    bytes: int  # size of the log
    messages: int  # samples written
    duration: float  # run seconds since the start of the log
    stopped: str  # why the acquisition process stopped thrust by itself; empty if it has not
    warnings: tuple[str, ...]
    skipped: int = 0  # set-points that a later one replaced before they could be sent
    links: dict[str, LinkStatus] = dataclasses.field(default_factory=dict)  # by device
    # By device: run time at which zero was written to its port. A device is missing if a command has followed.
    zeroed: dict[str, float] = dataclasses.field(default_factory=dict)
    alarm: str = ""  # why no data are written to the log at present; it is also the first of the warnings
    hints: tuple[str, ...] = ()  # possible improvements that are no faults, one line each


def count_senders(status: Status, device: str) -> tuple[int, int]:
    """Count the senders of one device.

    Parameters
    ----------
    status : Status
        Newest status.
    device : str
        Name of the device.

    Returns
    -------
    tuple of int
        Number of kinds of samples that it has sent, and number of its nodes that have sent a sample; both at least 1.
    """
    sent = [(source, latest) for source, latest in status.latest.items() if source[0].partition("/")[0] == device]
    nodes = {source[1] for source, _ in sent if source[1] is not None}
    return max(len({type(latest.sample) for _, latest in sent}), 1), max(len(nodes), 1)


def fields_of(sample: Sample) -> list[Any]:
    """Return the values of a sample in the order of its fields. It is ten times as fast as `dataclasses.astuple`."""
    return [getattr(sample, name) for name in type(sample).__slots__]


def to_json(status: Status) -> dict[str, Any]:
    """Return a status as a dictionary that `json.dumps` can write. NaN and infinity stay floats."""
    out = {field.name: getattr(status, field.name) for field in dataclasses.fields(status)}
    out["ports"] = [dataclasses.asdict(port) for port in status.ports.values()]
    out["links"] = {name: dataclasses.asdict(link) for name, link in status.links.items()}
    out["latest"] = [
        [device, node, type(latest.sample).__name__, fields_of(latest.sample), latest.t]
        for (device, node), latest in status.latest.items()
    ]
    return out


def from_json(data: dict[str, Any]) -> Status:
    """Return the status from a dictionary that `to_json` has made and JSON has transported."""
    ports = {port["name"]: PortStatus(**port | {"stuck": tuple(port["stuck"])}) for port in data["ports"]}
    latest: dict[Source, Latest] = {}
    for device, node, kind, values, t in data["latest"]:
        latest[device, node] = Latest(getattr(samples, kind)(*values), t)
    links = {
        name: LinkStatus(**{**link, "refused": tuple(link["refused"]), "changed": tuple(link["changed"])})
        for name, link in data["links"].items()
    }
    lines = {"warnings": tuple(data["warnings"]), "hints": tuple(data["hints"])}
    return Status(**{**data, **lines, "links": links, "ports": ports, "latest": latest})
