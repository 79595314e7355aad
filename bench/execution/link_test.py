"""Link test: measurement of the time in which an autopilot ends thrust after a lost link.

The failsafe that ends thrust, and its delay, depend on the autopilot's parameters, receiver and version. Therefore it
is tried: a tenth of full command is sent, then no frame at all, and the outputs (SERVO_OUTPUT_RAW) are recorded.

The result is written beside the rig (`RIG.link-test.json`). It contains the hash of the failsafe parameters, and
whether a receiver was heard. A mission with a command beyond `limits.link_test_n` needs a passed test.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
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
SILENCE_S = 10.0  # longest time without a frame to the autopilot
SETTLED_S = 0.5  # an output that is at neutral for so long stays there
# Longest time that passes the test: RC_OVERRIDE_TIME of 1 s, or the 0.5 s of FS_THR_ENABLE, plus a period of the
# reported outputs.
ALLOWED_S = 2.0
NEUTRAL = 0.02  # largest |n| of an output at zero thrust
PUSHED = 0.5  # fraction of the command that an output must reach before the silence to count as following it
MUTED = "muted"  # kind of the event after which no frame is sent


class LinkTest(msgspec.Struct, frozen=True):
    """Result of the link test of one autopilot: how soon it ended thrust after our frames stopped.

    Attributes
    ----------
    seconds : float
        Time [wall s] from our last frame until all outputs for thrusters are at neutral and stay there; 10 if this was
        not measured.
    n : float
        Command of the thrusters before the frames stopped, as a fraction of full command.
    date : str
        Time of the test, ISO 8601 in UTC.
    parameters : str
        SHA-256 of the autopilot's failsafe parameters in the test (seatrial.daq.drivers.link_loss_hash).
    receiver : bool or None
        Whether the autopilot received a radio-control transmitter; None if it did not report this.
    """

    seconds: float
    n: float
    date: str
    parameters: str
    receiver: bool | None = None

    @property
    def passed(self) -> bool:
        """Whether the link test is passed: thrust ended within 2 s (wall) of the last frame (`ALLOWED_S`)."""
        return self.seconds <= ALLOWED_S


class LinkTests(msgspec.Struct, frozen=True):
    """Content of the JSON file beside a rig file that stores the results of link tests.

    Attributes
    ----------
    format : str
        Name and version of the file format, "seatrial-link-test 1" (`FORMAT`).
    devices : dict of str to LinkTest
        Newest result of each autopilot, by its name.
    """

    format: str
    devices: dict[str, LinkTest]


FORMAT = "seatrial-link-test 1"


def link_test_path(rig: Rig) -> Path:
    """Return the path of the file with the results of a rig's link tests: RIG.link-test.json beside RIG.toml.

    The file need not exist.
    """
    return rig.path.with_suffix(".link-test.json")


def load_link_tests(rig: Rig) -> dict[str, LinkTest]:
    """Return the stored results of the link tests of a rig, by name of the autopilot.

    They are read from RIG.link-test.json beside the rig file. If it does not exist, the result is empty.

    Raises
    ------
    SeatrialError
        If the file cannot be read or has another format.
    """
    path = link_test_path(rig)
    if not path.is_file():
        return {}
    try:
        found = msgspec.json.decode(path.read_bytes(), type=LinkTests)
    except (OSError, msgspec.MsgspecError) as error:
        raise SeatrialError(
            f"{path}: not the result of a link test: {error}; delete this file, and repeat the link test"
        ) from error
    if found.format != FORMAT:
        raise SeatrialError(
            f"{path}: its format is '{found.format}', wanted '{FORMAT}'; delete this file, and repeat the link test"
        )
    return found.devices


def save_link_tests(rig: Rig, tests: Mapping[str, LinkTest]) -> None:
    """Write results of link tests to RIG.link-test.json beside the rig file.

    Parameters
    ----------
    rig : Rig
        The rig.
    tests : Mapping
        New results, by name of the autopilot. They replace stored results of the same autopilots; those of other
        autopilots stay in the file.

    Raises
    ------
    SeatrialError
        If the file exists and cannot be read or has another format, or if it cannot be written.
    """
    text = msgspec.json.encode(LinkTests(FORMAT, {**load_link_tests(rig), **tests}))
    write_output(link_test_path(rig), msgspec.json.format(text, indent=2) + b"\n")


def require_link_test(rig: Rig, device: str, link: LinkStatus, n_max: float) -> float:
    """Check that an autopilot has a valid stored link test, and return the time in which thrust ended in that test.

    A stored test is valid if it was passed with a command of at least 0.1, and if the failsafe parameters of the
    autopilot are the same as then. The autopilot must also have reported, then and now, whether it receives a
    radio-control transmitter, with the same answer.

    Parameters
    ----------
    rig : Rig
        The rig, beside whose file the results of link tests are stored.
    device : str
        Name of the autopilot.
    link : LinkStatus
        Present state of the autopilot, with its parameters and whether it receives a transmitter.
    n_max : float
        Largest command of the mission, for the message of an error.

    Returns
    -------
    float
        Wall seconds from the last frame to neutral outputs in the stored test.

    Raises
    ------
    SeatrialError
        If there is no valid test. The message names the reason and the command that does the test. Also if the file of
        stored tests cannot be read.
    """
    test = load_link_tests(rig).get(device)
    if test is None or _fault_of_stored(test):
        why = _fault_of_stored(test)
    elif test.parameters != link_loss_hash(link.parameters):
        why = f"the failsafe parameters have changed since {test.date}"
    elif link.receiver is None or test.receiver is None:
        when = "does not report" if link.receiver is None else f"did not report on {test.date}"
        why = f"its result depends on the transmitter, and the autopilot {when} whether it receives one (RC_CHANNELS)"
    elif test.receiver != link.receiver:
        then, now = ("no transmitter", "one") if link.receiver else ("a transmitter", "none")
        why = f"the test of {test.date} was done with {then} received, and {now} is received now"
    else:
        return test.seconds
    raise SeatrialError(
        f"{device}: the mission commands up to n = {n_max:.2f}, and above limits.link_test_n = "
        f"{rig.limits.link_test_n:g} a valid test of the lost link is needed: {why}; run `seatrial check "
        f"{rig.path.name} --actuators --link-test --arm`"
    )


def missing_link_tests(rig: Rig, thrusters: Sequence[str], n_max: float) -> list[tuple[str, str, str]]:
    """Return the autopilots without the stored link test that a mission needs. No autopilot is asked.

    Whether the failsafe parameters are still those of a stored test is known only with the autopilot
    (`require_link_test`).

    Parameters
    ----------
    rig : Rig
        The rig, beside whose file the results of link tests are stored.
    thrusters : sequence of str
        Names of the thrusters of the mission.
    n_max : float
        Largest command of the mission. At most `limits.link_test_n` needs no test.

    Returns
    -------
    list of (str, str, str)
        Name of the autopilot, why the run would be refused, and what to do.

    Raises
    ------
    SeatrialError
        If the file of stored tests cannot be read.
    """
    if not n_max > rig.limits.link_test_n:
        return []
    driven = [thruster for name in thrusters if (thruster := rig.thruster(name)).output is not None]
    tests = load_link_tests(rig)
    faults = {name: _fault_of_stored(tests.get(name)) for name in dict.fromkeys(t.device for t in driven)}
    needed = f"commands up to n = {n_max:.2f} need a valid test of the lost link, above {rig.limits.link_test_n:g}"
    advice = f"run `seatrial check {rig.path.name} --actuators --link-test --arm`"
    return [(name, f"{needed} (limits.link_test_n): {why}", advice) for name, why in faults.items() if why]


def _fault_of_stored(test: LinkTest | None) -> str:
    """Return why a stored link test is not valid, whatever the autopilot reports now; empty if it may be valid."""
    if test is None:
        return "it was never done"
    if not test.passed:
        return f"on {test.date} thrust went on for {test.seconds:.2f} s"
    if test.n < N_TEST:
        return f"the test of {test.date} commanded n = {test.n:g}, which is below {N_TEST:g}"
    return ""


def link_test_plan(rig: Rig) -> Mission:
    """Return the mission of a link test, for all thrusters of a rig that are connected to an autopilot.

    The command is zero for 1 s, then 0.1 (a tenth of full command) until the end of the mission after 13.5 s. After the
    first 3 s the runner stops the frames. These times are wall seconds. The mission counts run seconds, so that its
    times are longer on mocks that are faster than real time.

    Raises
    ------
    SeatrialError
        If no thruster of the rig is connected to an autopilot, or if `limits.n_max` is below 0.1.
    """
    names = tuple(thruster.name for thruster in rig.thrusters if thruster.output is not None)
    if not names:
        raise SeatrialError(
            f"{rig.path}: --link-test needs an autopilot, and no thruster is connected to one; leave --link-test out"
        )
    if rig.limits.n_max < N_TEST:
        raise SeatrialError(
            f"{rig.path}: --link-test commands n = {N_TEST:g}, and limits.n_max is {rig.limits.n_max:g}; "
            "raise n_max for the test: a smaller output cannot be distinguished from rest"
        )
    times = np.array([0.0, REST_S * rig.speed])
    segments = (
        Segment(STATIC, times[:1], np.zeros((1, len(names)))),
        Segment("silence", times[1:], np.full((1, len(names)), N_TEST)),
    )
    end = (REST_S + HOLD_S + SILENCE_S + SETTLED_S) * rig.speed
    return Mission("link test", "mission", names, segments, end, n_max=N_TEST, made_by="seatrial check --link-test")


def measure_link_loss(log: Log, device: Device, link: LinkStatus, n: float) -> LinkTest:
    """Return the result of a link test for one autopilot, from the log of the test. No file is written.

    In the test the thrusters were commanded ``n``, and then no frame was sent to the autopilot for up to 10 s (wall).

    Parameters
    ----------
    log : Log
        The closed log of the test.
    device : Device
        The autopilot.
    link : LinkStatus
        State of the autopilot before frames stopped. Its parameters and receiver are stored in the result.
    n : float
        Command before frames stopped, as a fraction of full command.

    Returns
    -------
    LinkTest
        Result, dated with the present time, with the time from the last frame until the last output was at neutral
        (|n| at most 0.02) and stayed there. This time is 10 s (`SILENCE_S`) if an output was not at neutral when frames
        were sent again, or was not reported between. A value of NaN counts as not at neutral.

    Raises
    ------
    SeatrialError
        If the log lacks the event at which the runner stopped frames, or frames to this autopilot. Also if the last
        output of a thruster before frames stopped was below half of ``n`` in absolute value or was not reported: its
        neutral value afterwards then proves nothing.
    """
    rig = log.rig
    assert rig is not None
    muted = [t for t, kind, _ in log.events() if kind == MUTED]
    sent = np.array([t for t, direction, _ in log.raw(device.name) if direction == "tx"])
    if not muted or not sent.size:
        raise SeatrialError(f"{log.path}: the log contains no link test (it ended too early); repeat the link test")
    last = float(sent[sent < muted[0] + 0.5 * SETTLED_S * rig.speed].max())
    resumed = float(min(sent[sent > last], default=math.inf))
    seconds = 0.0
    for thruster in rig.thrusters:
        if thruster.device != device.name:
            continue
        table = log.table(Servo, device.name, thruster.node)
        before = table["n"][table["t"] <= last]
        if not (before.size and abs(before[-1]) >= PUSHED * n):
            output = f"was n = {before[-1]:+.2f}" if before.size else "was not reported"
            raise SeatrialError(
                f"{log.path}: thruster {thruster.name} gave no thrust before the link was interrupted, so the link "
                f"test proves nothing: its output {output}, commanded {n:+.2f}; arm {device.name}, and check its dead "
                "zone (RCn_DZ)"
            )
        table = table[(table["t"] > last) & (table["t"] < resumed)]
        pushes = np.flatnonzero(~(np.abs(table["n"]) <= NEUTRAL))  # NaN counts as pushing
        k = int(pushes[-1]) + 1 if pushes.size else 0  # the first row from which the output stays at neutral
        seconds = max(seconds, (float(table["t"][k]) - last) / rig.speed if k < len(table) else math.inf)
    date = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    seconds = seconds if math.isfinite(seconds) else SILENCE_S
    return LinkTest(seconds, n, date, link_loss_hash(link.parameters), link.receiver)
