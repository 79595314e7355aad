"""The link test: how soon an autopilot ends thrust when we fall silent, measured at its own outputs and kept.

Which of its failsafes ends thrust, and when, depends on parameters, on the receiver and on its version; so it is tried:
a tenth of full command, nothing more is sent, and SERVO_OUTPUT_RAW is watched. The result stands beside the rig
(`RIG.link-test.json`) with the hash of the parameters that decide it and whether a receiver was heard, and missions
beyond `limits.link_test_n` need it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from seatrial.daq.config import STATIC, Mission, Segment
from seatrial.daq.drivers import LinkStatus, link_loss_hash
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.daq.log import Log
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import Servo

N_TEST = 0.1  # of full command
# Wall seconds.
REST_S, HOLD_S = 1.0, 2.0  # at zero and at N_TEST before the silence
SILENCE_S = 10.0  # of ours, at most
SETTLED_S = 0.5  # at neutral, and it stays there
ALLOWED_S = 2.0  # RC_OVERRIDE_TIME of a second, or half of one of FS_THR_ENABLE, and what the outputs' rate adds
NEUTRAL = 0.02  # n of an output that pushes nothing
PUSHED = 0.5  # of the command: an output of less, before the silence, did not follow it
MUTED = "muted"  # event: nothing is sent from here on


class LinkTest(msgspec.Struct, frozen=True):
    """What a link test of one autopilot has found."""

    seconds: float  # from our last frame to the last output at neutral
    n: float  # commanded before
    date: str  # ISO 8601, UTC
    parameters: str  # SHA-256 of those that decide (seatrial.daq.drivers.link_loss_hash)
    receiver: bool | None = None  # whether one was heard; None: not known

    @property
    def passed(self) -> bool:
        """Whether thrust ended soon enough."""
        return self.seconds <= ALLOWED_S


class LinkTests(msgspec.Struct, frozen=True):
    """The file beside a rig."""

    format: str
    devices: dict[str, LinkTest]


FORMAT = "seatrial-link-test 1"


def link_test_path(rig: Rig) -> Path:
    """Where the result stands."""
    return rig.path.with_suffix(".link-test.json")


def load_link_tests(rig: Rig) -> dict[str, LinkTest]:
    """The results by device; none where there is no such file. Raises SeatrialError for one that is none."""
    path = link_test_path(rig)
    if not path.is_file():
        return {}
    try:
        found = msgspec.json.decode(path.read_bytes(), type=LinkTests)
    except (OSError, msgspec.MsgspecError) as error:
        raise SeatrialError(f"{path}: no result of a link test: {error}") from error
    if found.format != FORMAT:
        raise SeatrialError(f"{path}: its format is '{found.format}', wanted '{FORMAT}'")
    return found.devices


def save_link_tests(rig: Rig, tests: Mapping[str, LinkTest]) -> None:
    """Replace the results of these devices."""
    text = msgspec.json.encode(LinkTests(FORMAT, {**load_link_tests(rig), **tests}))
    write_output(link_test_path(rig), msgspec.json.format(text, indent=2) + b"\n")


def require_link_test(rig: Rig, device: str, link: LinkStatus, n_max: float) -> float:
    """Seconds that a passed test has measured with the parameters and the receiver of `link`.

    Raises SeatrialError where there is none.
    """
    test = load_link_tests(rig).get(device)
    if test is None:
        why = "it was never done"
    elif not test.passed:
        why = f"on {test.date} thrust went on for {test.seconds:.2f} s"
    elif test.n < N_TEST:
        why = f"that of {test.date} commanded n = {test.n:g}, which is below {N_TEST:g}"
    elif test.parameters != link_loss_hash(link.parameters):
        why = f"parameters that decide it have changed since {test.date}"
    elif link.receiver is None or test.receiver is None:
        whose = "now" if link.receiver is None else f"in that of {test.date}"
        why = f"whether it hears a receiver, which decides it, is not known {whose} (RC_CHANNELS)"
    elif test.receiver != link.receiver:
        then, now = ("no receiver", "one") if link.receiver else ("a receiver", "none")
        why = f"that of {test.date} was done with {then}, and {now} is heard now"
    else:
        return test.seconds
    raise SeatrialError(
        f"{device}: the plan commands up to n = {n_max:.2f}, and beyond limits.link_test_n = "
        f"{rig.limits.link_test_n:g} a link test is needed; {why}: "
        f"`seatrial check {rig.path.name} --actuators --link-test`"
    )


def link_test_plan(rig: Rig) -> Mission:
    """N_TEST on every thruster behind an autopilot, for as long as the silence may last. Raises SeatrialError."""
    names = tuple(thruster.name for thruster in rig.thrusters if thruster.output is not None)
    if not names:
        raise SeatrialError(f"{rig.path}: --link-test is of an autopilot, and no thruster hangs behind one")
    if rig.limits.n_max < N_TEST:
        raise SeatrialError(
            f"{rig.path}: --link-test commands n = {N_TEST:g}, and limits.n_max is {rig.limits.n_max:g}; "
            "raise it for the test: an output at less cannot be told from one at rest"
        )
    times = np.array([0.0, REST_S * rig.speed])
    segments = (
        Segment(STATIC, times[:1], np.zeros((1, len(names)))),
        Segment("silence", times[1:], np.full((1, len(names)), N_TEST)),
    )
    end = (REST_S + HOLD_S + SILENCE_S + SETTLED_S) * rig.speed
    return Mission("link test", "mission", names, segments, end, n_max=N_TEST, made_by="seatrial check --link-test")


def measure_link_loss(log: Log, device: Device, link: LinkStatus, n: float) -> LinkTest:
    """What the log of a link test says about one device; SILENCE_S where thrust went on to the end. `link` is its state
    before the silence.

    Raises SeatrialError where the log has no such test, or where an output did not push before the silence: then its
    being at neutral says nothing.
    """
    rig = log.rig
    assert rig is not None
    muted = [t for t, kind, _ in log.events() if kind == MUTED]
    sent = np.array([t for t, direction, _ in log.raw(device.name) if direction == "tx"])
    if not muted or not sent.size:
        raise SeatrialError(f"{log.path}: no silence of ours in it")
    last = float(sent[sent < muted[0] + 0.5 * SETTLED_S * rig.speed].max())
    resumed = float(min(sent[sent > last], default=math.inf))
    seconds = 0.0
    for thruster in rig.thrusters:
        if thruster.device != device.name:
            continue
        table = log.table(Servo, device.name, thruster.node)
        before = table["n"][table["t"] <= last]
        if not (before.size and abs(before[-1]) >= PUSHED * n):
            told = f"n = {before[-1]:+.2f}" if before.size else "nothing"
            raise SeatrialError(
                f"{log.path}: {thruster.name} did not push before the silence, so the link test says nothing: its "
                f"output was {told}, commanded {n:+.2f}; is {device.name} armed, and does no dead zone (RCn_DZ) eat it?"
            )
        table = table[(table["t"] > last) & (table["t"] < resumed)]
        pushes = np.flatnonzero(~(np.abs(table["n"]) <= NEUTRAL))
        k = int(pushes[-1]) + 1 if pushes.size else 0
        seconds = max(seconds, (float(table["t"][k]) - last) / rig.speed if k < len(table) else math.inf)
    date = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    seconds = seconds if math.isfinite(seconds) else SILENCE_S
    return LinkTest(seconds, n, date, link_loss_hash(link.parameters), link.receiver)
