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
    """The newest sample of a source.

    Attributes
    ----------
    sample
        The sample.
    t
        Estimated run time of the sample [s].
    """

    sample: Sample
    t: float


class StreamedSample(NamedTuple):
    """A sample of a device as it is written to the log.

    Attributes
    ----------
    device
        Name of the device.
    sample
        The sample.
    t
        Estimated run time of the sample [s].
    """

    device: str
    sample: Sample
    t: float


@dataclass(frozen=True)
class PortStatus:
    """State of the port of one device. Counters start at the start of the log. Rates and ages refer to run time.

    Attributes
    ----------
    name
        Name of the device.
    protocol
        Name of its protocol, such as "vectornav".
    port
        Device file or network address of the port.
    expected
        Samples per run second by the rig file (`rate_hz`).
    rate
        Measured samples per run second over the last few seconds, of the kind to which `expected` applies; NaN while
        there are too few samples for a rate.
    age
        Run seconds since the last sample of any kind, except transducers; infinite before the first.
    samples
        Number of decoded samples of all kinds.
    frames
        Number of valid frames.
    checksum_errors
        Number of frames with a wrong checksum.
    unparsed_bytes
        Number of received bytes that belong to no valid frame.
    dropped
        Number of samples, and of reads and writes without samples, that were not logged, because the queue of the log
        was full.
    reconnects
        How often the port was opened again after a loss.
    bytes_in
        Number of received bytes.
    latency
        Mean of receive time minus estimated sample time [s]; NaN for a device without a clock, or before its first
        sample.
    latency_spread
        Standard deviation of the same difference [s]; NaN for a device without a clock, or before its second sample.
    message
        Fault of the port in one line, else `remark`; empty without both.
    remark
        Note for the user on a stream without a fault.
    stuck
        Class names of samples that repeat the same values, as those of a dead sensor do.
    open
        Whether the port is open: False before it was opened and after it was lost.
    """

    name: str
    protocol: str
    port: str
    expected: float
    rate: float
    age: float
    samples: int
    frames: int
    checksum_errors: int
    unparsed_bytes: int
    dropped: int
    reconnects: int
    bytes_in: int
    latency: float
    latency_spread: float
    message: str
    remark: str = ""
    stuck: tuple[str, ...] = ()
    open: bool = True


@dataclass(frozen=True)
class Status:
    """State of the whole acquisition at run time `t`.

    Attributes
    ----------
    t
        Run time [s].
    ports
        State of each port, by name of the device.
    latest
        Newest samples by `Source`: name of the device (and kind of the sample), and node. The node is None except for
        speed controllers and servo outputs.
    commanded
        Present command n_cmd, -1..1, of each thruster; 0 before the first command. It is 0 as soon as zero is
        commanded; whether zero was sent is in `zeroed`.
    pending
        Number of set-points that wait for their time.
    path
        Path of the log.
    bytes
        Size of the log [bytes].
    messages
        Number of samples written.
    duration
        Run seconds since the start of the log.
    stopped
        Why the acquisition process stopped thrust by itself, or ends without a request of its parent; empty otherwise.
    warnings
        Faults of ports, of the log and of the run, one line each.
    skipped
        Number of set-points that a later one replaced before they could be sent.
    links
        State of each autopilot, by name of the device.
    zeroed
        Run time [s] at which zero was sent to all thrusters of a device that have had a command, by name of the device.
        A device is missing if nothing was sent yet, or if another command has followed.
    alarm
        Why no data are written to the log at present; it is also the first of the warnings. Empty otherwise.
    hints
        Possible improvements that are no faults, one line each.
    """

    t: float
    ports: dict[str, PortStatus]
    latest: dict[Source, Latest]
    commanded: dict[str, float]
    pending: int
    path: str
    bytes: int
    messages: int
    duration: float
    stopped: str
    warnings: tuple[str, ...]
    skipped: int = 0
    links: dict[str, LinkStatus] = dataclasses.field(default_factory=dict)
    zeroed: dict[str, float] = dataclasses.field(default_factory=dict)
    alarm: str = ""
    hints: tuple[str, ...] = ()


def count_senders(status: Status, device: str) -> tuple[int, int]:
    """Count the kinds of samples and the nodes of one device that have sent a sample so far.

    They are for the decision whether a sample is too old: the nodes of a device share its expected rate, and a device
    with several kinds of samples may send one kind more slowly.

    Parameters
    ----------
    status : Status
        Newest status.
    device : str
        Name of the device.

    Returns
    -------
    tuple of int
        Number of kinds of samples that it has sent, and number of its nodes that have sent a sample; both at least 1,
        also if it has sent none.
    """
    sent = [(source, latest) for source, latest in status.latest.items() if source[0].partition("/")[0] == device]
    nodes = {source[1] for source, _ in sent if source[1] is not None}
    return max(len({type(latest.sample) for _, latest in sent}), 1), max(len(nodes), 1)


def fields_of(sample: Sample) -> list[Any]:
    """Return the values of a sample in the order of its fields, ten times as fast as `dataclasses.astuple`.

    Of a `Transducer` the inherited field `value` is missing.
    """
    return [getattr(sample, name) for name in type(sample).__slots__]


def to_json(status: Status) -> dict[str, Any]:
    """Return a status of the acquisition as a dictionary that `json.dumps` can write. NaN and infinity stay floats."""
    out = {field.name: getattr(status, field.name) for field in dataclasses.fields(status)}
    out["ports"] = [dataclasses.asdict(port) for port in status.ports.values()]
    out["links"] = {name: dataclasses.asdict(link) for name, link in status.links.items()}
    out["latest"] = [
        [device, node, type(latest.sample).__name__, fields_of(latest.sample), latest.t]
        for (device, node), latest in status.latest.items()
    ]
    return out


def from_json(data: dict[str, Any]) -> Status:
    """Return the status of the acquisition from a dictionary that `to_json` has made and JSON has transported."""
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
