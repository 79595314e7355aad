"""Questions about a new rig, and the draft from their answers.

An option of the command line answers a question in advance. Without a terminal no question is asked, and the default is
taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import click

from seatrial.daq.config import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.new_rig.draft import (
    LIMITS,
    RECEIVERS,
    DeviceDraft,
    Number,
    RigDraft,
    ThrusterDraft,
    Value,
    drafts_of,
    drivers_of,
    name_devices,
    reports,
    rig_text,
    usual_baud,
    usual_port,
    usual_rate,
)
from seatrial.daq.protocol import DEVICES
from seatrial.daq.rig import LOAD_CELLS, NAME
from seatrial.daq.tools import SIDES, SLCAN, DiscoveredDevice

BESIDE_M = dict(SIDES.values())  # assumed position to starboard [m] by name
Answer = TypeVar("Answer")


class WantedDevice(NamedTuple):
    """Device that the user names: `PROTOCOL`, `PROTOCOL@PORT`, or with `@BAUD` and `@HZ` behind the port.

    Attributes
    ----------
    protocol
        Name of its protocol.
    port
        Its port; "" if it is not given.
    baud
        Its baud rate; None if it is not given.
    rate_hz
        Rate of its samples [Hz]; None if it is not given.
    """

    protocol: str
    port: str = ""
    baud: int | None = None
    rate_hz: float | None = None


@dataclass(frozen=True)
class RigAnswers:
    """Answers that the options of the command line give in advance. None, or empty: not given.

    Attributes
    ----------
    kind
        "boat" or "bench".
    name
        Name of the boat or bench.
    devices
        Devices that the user names.
    search
        Whether to search the ports for devices; None: ask.
    thrusters
        Names of the thrusters.
    nodes
        Ids of their controllers, in the same order.
    positions
        Positions [m] of thrusters by name.
    pole_pairs, rpm_max, timeout_s
        Values for all thrusters; see `Thruster`.
    lever_arm_m
        Position of the GNSS antenna [m].
    newton_per_count
        Gain of the load cells [N/count].
    limits
        Limits by key of the rig file.
    """

    kind: str | None = None
    name: str | None = None
    devices: Sequence[WantedDevice] = ()
    search: bool | None = None
    thrusters: Sequence[str] = ()
    nodes: Sequence[int] = ()
    positions: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    pole_pairs: int | None = None
    rpm_max: float | None = None
    timeout_s: float | None = None
    lever_arm_m: tuple[float, float, float] | None = None
    newton_per_count: float | None = None
    limits: Mapping[str, float] = field(default_factory=dict)


class Interview:
    """Interview of the user at a terminal. Without a terminal every question has its default as the answer.

    Parameters
    ----------
    at_terminal
        Whether questions are asked. They are printed to stderr.
    """

    def __init__(self, at_terminal: bool) -> None:
        """Make an interview; `at_terminal` is whether questions are asked."""
        self.at_terminal = at_terminal

    def value(
        self, given: Answer | None, question: str, default: Answer, parse: Callable[[str], Answer]
    ) -> Value[Answer]:
        """Return the answer to a question. It counts as given unless it is the default that nobody has confirmed.

        Parameters
        ----------
        given
            Answer of an option; None if the option is not given. With it the question is not asked.
        question
            Text of the question.
        default
            Answer if the user enters nothing, or if no question is asked.
        parse
            Function that converts a text, and raises ValueError with the reason if it is not an answer. The question
            is then asked again.
        """
        if given is not None:
            return Value(given)
        while self.at_terminal:
            text = click.prompt(f"{question} [{_shown(default)}]", default="", show_default=False, err=True).strip()
            if not text:
                break
            try:
                return Value(parse(text))
            except ValueError as error:
                click.echo(f"  {error}", err=True)
        return Value(default, False)

    def text(self, question: str) -> str:
        """Return the line that the user enters; "" without a terminal."""
        if not self.at_terminal:
            return ""
        return str(click.prompt(question, default="", show_default=False, err=True)).strip()

    def agrees(self, question: str) -> bool:
        """Return whether the user agrees, which an empty line also means. False without a terminal."""
        return self.at_terminal and click.confirm(question, default=True, err=True)


def _shown(value: object) -> str:
    """Return a default as the user would enter it: numbers without a needless fraction, tuples with commas, none."""
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return ",".join(_shown(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


# Protocols of devices whose name is given in place of a protocol.
USUAL_PROTOCOLS = {
    **dict.fromkeys(("gps", "gnss", "receiver"), "nmea and ubx"),
    **dict.fromkeys(("imu", "ahrs", "ins"), "vectornav and mip"),
    **dict.fromkeys(("esc", "motor", "thruster", "can"), "vesc and dronecan"),
    **dict.fromkeys(("autopilot", "ardupilot", "pixhawk"), "mavlink"),
    **dict.fromkeys(("cell", "force", "scale"), "loadcell, openscale and mantracourt"),
    "compass": "nmea and nmea2000",
}


def parse_devices(text: str) -> list[WantedDevice]:
    """Parse a list of devices with commas: `PROTOCOL[@PORT[@BAUD[@HZ]]]` each. An empty text gives an empty list.

    Raises
    ------
    ValueError
        If a protocol is unknown, or if a baud rate or a rate is not a positive number.
    """
    found = []
    for part in (part.strip() for part in text.split(",") if part.strip()):
        protocol, *rest = part.split("@")
        if protocol not in DEVICES:
            usual = USUAL_PROTOCOLS.get(protocol.lower(), "")
            hint = f"; the usual ones of a device of this name are {usual}" if usual else ""
            raise ValueError(f"{protocol!r} is not a protocol; known: {', '.join(DEVICES)}{hint}")
        if len(rest) > 3:
            raise ValueError(f"{part!r} has more parts than PROTOCOL@PORT@BAUD@HZ")
        port, baud, rate = [*rest, "", "", ""][:3]
        try:
            what = "baud rate"
            bits = parse_whole(baud, 1) if baud else None
            what = "rate in Hz"
            found.append(WantedDevice(protocol, port, bits, parse_positive(rate) if rate else None))
        except ValueError as problem:
            form = "write PROTOCOL@PORT@BAUD@HZ, such as nmea@/dev/ttyUSB1@38400@5"
            raise ValueError(f"the {what} of {part!r}: {problem}; {form}") from None
    return found


def parse_whole(text: str, least: int = 0) -> int:
    """Parse a whole number of at least `least`. Any other text raises ValueError."""
    try:
        number = int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None
    if number < least:
        raise ValueError(f"{number} is less than {least}")
    return number


def parse_number(text: str) -> float:
    """Parse a finite number. Any other text raises ValueError."""
    try:
        number = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number") from None
    if not abs(number) < float("inf"):
        raise ValueError(f"{text!r} is not a finite number")
    return number


def parse_positive(text: str) -> float:
    """Parse a number above zero. Any other text raises ValueError."""
    number = parse_number(text)
    if number <= 0.0:
        raise ValueError(f"{text} is not above zero")
    return number


def parse_share(text: str) -> float:
    """Parse a number above zero and at most one. Any other text raises ValueError."""
    number = parse_positive(text)
    if number > 1.0:
        raise ValueError(f"{text} is above 1")
    return number


def parse_gain(text: str) -> float:
    """Parse the gain of a load cell [N/count], which may be negative. Zero and any other text raise ValueError."""
    number = parse_number(text)
    if number == 0.0:
        raise ValueError("the gain must not be zero")
    return number


def parse_position(text: str) -> tuple[float, float, float]:
    """Parse a position `X,Y,Z` [m]: forward, starboard, down. Any other text raises ValueError."""
    parts = text.split(",")
    if len(parts) != 3:
        raise ValueError(f"{text!r} is not X,Y,Z: forward, starboard, down in metres, such as 0.3,0,-0.45")
    forward, starboard, down = (parse_number(part.strip()) for part in parts)
    return forward, starboard, down


def _parse_name(text: str) -> str:
    """Return the name of a rig unchanged. A text with characters that are not printable raises ValueError."""
    if not text.isprintable():
        raise ValueError("the name has characters that are not printable")
    return text


def parse_kind(text: str) -> str:
    """Parse the kind of a rig. A text other than boat and bench raises ValueError."""
    if text not in ("boat", "bench"):
        raise ValueError(f"{text!r} is neither boat nor bench")
    return text


def draft_rig(
    answers: RigAnswers,
    usual_name: str,
    interview: Interview,
    search: Callable[[], Sequence[DiscoveredDevice]],
) -> tuple[RigDraft, str]:
    """Return the draft of a rig, and its kind ("boat" or "bench"), after the questions that the options leave open.

    Parameters
    ----------
    answers
        Answers of the options.
    usual_name
        Name of the rig if the user gives none.
    interview
        Interview of the user.
    search
        Function that finds devices; it is called at most once.

    Raises
    ------
    SeatrialError
        If there is no device, if the numbers of thrusters and nodes differ, or if a position is given for a thruster
        that the rig does not have.
    click.Abort
        If the user ends the interview.
    """
    kind = interview.value(answers.kind, "boat or bench", "boat", parse_kind).content
    name = interview.value(answers.name, "name of the rig", usual_name, _parse_name)
    found, buses = _searched(answers, interview, search)
    devices = [*found, *_named_devices(answers, interview, found, buses)]
    if not devices:
        raise SeatrialError(
            "a rig needs a device, and none was found or named; name the devices with --devices, such as "
            "--devices vectornav,nmea,vesc"
        )
    thrusters = _thrusters(answers, interview, devices, kind)
    return RigDraft(name, devices, thrusters, _limits(answers, interview, devices, thrusters, kind)), kind


def _searched(
    answers: RigAnswers, interview: Interview, search: Callable[[], Sequence[DiscoveredDevice]]
) -> tuple[list[DeviceDraft], list[str]]:
    """Return the drafts of discovered devices, and the ports of CAN buses, after the user has agreed to the search.

    The protocol of a CAN bus is not known. Ports without a known device are left out. Both lists may be empty.
    """
    wanted = answers.search
    if wanted is None and not answers.devices:
        wanted = interview.agrees("search the ports for devices now? Devices have to be switched on")
    all_ports = search() if wanted else ()
    buses = [device.port for device in all_ports if device.port.startswith("socketcan:")]
    buses += [f"slcan:{device.port}" for device in all_ports if device.protocol == SLCAN]
    return [_completed(draft, answers, interview) for draft in drafts_of(all_ports)], buses


def _named_devices(
    answers: RigAnswers, interview: Interview, found: Sequence[DeviceDraft], buses: Sequence[str]
) -> list[DeviceDraft]:
    """Return the drafts of the devices that the user names, beside those that were found.

    The first of `buses`, the CAN buses that were found, is proposed as the port of a device on a CAN bus.
    """
    wanted = list(answers.devices)
    if not wanted and interview.at_terminal:
        click.echo("devices that were not found, as PROTOCOL or PROTOCOL@PORT, with commas; protocols:", err=True)
        for protocol, row in DEVICES.usable().items():
            click.echo(f"  {protocol:12} {row.description}", err=True)
        while True:
            try:
                wanted = parse_devices(interview.text("devices [none]"))
                break
            except ValueError as error:
                click.echo(f"  {error}", err=True)
    names = name_devices([*(device.protocol for device in found), *(device.protocol for device in wanted)])[
        len(found) :
    ]
    drafts: list[DeviceDraft] = []
    for device, name in zip(wanted, names, strict=True):
        taken = [draft.port.content for draft in (*found, *drafts)]
        number = sum(port.startswith("/dev/ttyUSB") for port in taken)
        named = DeviceDraft(name, device.protocol, Value(""), None, Value(1.0))
        port = interview.value(
            device.port or None,
            f"port of {name} ({device.protocol})",
            usual_port(device.protocol, number, buses),
            _port_parser(named, [*found, *drafts]),
        )
        usual = usual_baud(device.protocol, port.content)
        baud = None
        if usual is not None:
            baud = interview.value(device.baud, f"baud rate of {name}", usual, lambda text: parse_whole(text, 1))
        rate = interview.value(
            device.rate_hz, f"samples per second of {name}", usual_rate(device.protocol), parse_positive
        )
        draft = DeviceDraft(name, device.protocol, port, baud, rate, about=DEVICES[device.protocol].description)
        drafts.append(_completed(draft, answers, interview))
    return drafts


def _port_parser(device: DeviceDraft, others: Sequence[DeviceDraft]) -> Callable[[str], str]:
    """Return a function that returns a port unchanged if a rig file may have it for a device beside `others`.

    The parser of rig files decides. Its message is that of the ValueError that the function raises otherwise.
    """

    def parse(port: str) -> str:
        """Return the port unchanged, after the parser of rig files has accepted it."""
        _check(RigDraft(Value("rig"), [*others, replace(device, port=Value(port))]))
        return port

    return parse


def _check(draft: RigDraft) -> None:
    """Raise ValueError with the message of the parser of rig files if it does not accept a draft."""
    try:
        parse_rig(rig_text(draft), "rig.toml")
    except SeatrialError as error:
        raise ValueError(str(error)) from error


def _completed(device: DeviceDraft, answers: RigAnswers, interview: Interview) -> DeviceDraft:
    """Return a device with the lever arm of its antenna or the gain of its load cell, if it has one of them."""
    if device.protocol in RECEIVERS:
        lever = interview.value(
            answers.lever_arm_m,
            f"antenna of {device.name}: forward, starboard, down [m]",
            (0.0, 0.0, 0.0),
            parse_position,
        )
        return replace(device, lever_arm_m=lever)
    if device.protocol in LOAD_CELLS and device.protocol != "openscale":
        gain = interview.value(answers.newton_per_count, f"gain of {device.name} [N/count]", 0.001, parse_gain)
        return replace(device, newton_per_count=gain)
    return device


def _thrusters(
    answers: RigAnswers, interview: Interview, devices: Sequence[DeviceDraft], kind: str
) -> list[ThrusterDraft]:
    """Return the thrusters of the first device that can drive some and brings no tables of its own; else none.

    Raises
    ------
    SeatrialError
        If the options do not fit together, or name thrusters of a rig without a device that drives them.
    """
    drivers = drivers_of(devices)
    if not drivers:
        given = {
            "--thrusters": answers.thrusters,
            "--nodes": answers.nodes,
            "--position-m": answers.positions,
            "--pole-pairs": answers.pole_pairs,
            "--rpm-max": answers.rpm_max,
        }
        if options := [option for option, value in given.items() if value]:
            raise SeatrialError(
                f"{options[0]} needs a device that drives thrusters; add vesc, dronecan or mavlink to --devices"
            )
        return []
    driver = drivers[0]
    usual = ("thruster",) if kind == "bench" else ("left", "right")
    names = interview.value(
        tuple(answers.thrusters) or None, f"names of the thrusters of {driver.name}, with commas", usual, _parse_names
    )
    if answers.nodes and len(answers.nodes) != len(names.content):
        raise SeatrialError(
            f"--nodes gives {len(answers.nodes)} numbers for {len(names.content)} thrusters "
            f"({', '.join(names.content)}); give one for each"
        )
    if unknown := [name for name in answers.positions if name not in names.content]:
        raise SeatrialError(
            f"--position-m: there is no thruster {unknown[0]!r}; the thrusters are {', '.join(names.content)}"
        )
    autopilot = driver.protocol == "mavlink"
    # A skid-steered ArduPilot Rover has its left throttle at output 1 and its right one at output 3.
    usual_nodes = (1, 3) if autopilot else (1, 2) if driver.protocol == "vesc" else (0, 1)
    nodes, positions = [], []
    for k, name in enumerate(names.content):
        usual_node = usual_nodes[k] if k < len(usual_nodes) else usual_nodes[-1] + k - 1
        nodes.append(
            interview.value(
                answers.nodes[k] if answers.nodes else None, f"node of {name}", usual_node, _node_parser(driver)
            )
        )
        beside = (0.0, 0.0 if kind == "bench" else BESIDE_M.get(name, 0.0), 0.0)
        positions.append(
            interview.value(
                answers.positions.get(name), f"position of {name}: forward, starboard, down [m]", beside, parse_position
            )
        )
    poles, speed = Value(1, False), Value(3600.0, False)
    if not autopilot:
        poles = interview.value(answers.pole_pairs, "pole pairs of the motors", 7, lambda text: parse_whole(text, 1))
        speed = interview.value(answers.rpm_max, "shaft speed at full command [rev/min]", 3600.0, parse_positive)
    timeout = interview.value(answers.timeout_s, "time-out in the controllers [s]", 1.0, parse_positive)
    return [
        ThrusterDraft(Value(name, names.given), driver.name, driver.protocol, node, position, poles, speed, timeout)
        for name, node, position in zip(names.content, nodes, positions, strict=True)
    ]


def _node_parser(driver: DeviceDraft) -> Callable[[str], int]:
    """Return a function that parses the node of a thruster of a device; the parser of rig files decides its range."""

    def parse(text: str) -> int:
        """Return the number, after the parser of rig files has accepted it."""
        node = parse_whole(text)
        whole, number = Value(1), Value(1.0)
        place = Value((0.0, 0.0, 0.0))
        thruster = ThrusterDraft(Value("a"), driver.name, driver.protocol, Value(node), place, whole, number, number)
        _check(RigDraft(Value("rig"), [driver], [thruster]))
        return node

    return parse


def _parse_names(text: str) -> tuple[str, ...]:
    """Parse names of thrusters with commas. Raise ValueError for no name, a name that occurs twice or is not valid."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names or len(set(names)) < len(names) or not all(NAME.fullmatch(name) for name in names):
        raise ValueError("give names with commas, each once: a letter, then letters, digits or _")
    return names


def _limits(
    answers: RigAnswers,
    interview: Interview,
    devices: Sequence[DeviceDraft],
    thrusters: Sequence[ThrusterDraft],
    kind: str,
) -> dict[str, Number]:
    """Return the limits of the rig by key: those of the options, and proposals for those that a device reports.

    A rig without thrusters gets only the limits of the options. The distance from the start is proposed only for a
    boat, and the force only for a bench. A limit with a proposal that only the user can know is left out without an
    answer.
    """
    drives = bool(thrusters) or any(device.drives for device in devices)
    found: dict[str, Number] = {}
    for key, kind_of_limit in LIMITS.items():
        if key not in answers.limits:
            elsewhere = (key == "radius_m" and kind == "bench") or (key == "force_n" and kind == "boat")
            if not drives or elsewhere or not reports(key, devices):
                continue
        parse = parse_share if key in ("n_max", "link_test_n") else parse_positive
        question = f"{key}: {kind_of_limit.words}"
        if kind_of_limit.guessed:
            found[key] = interview.value(answers.limits.get(key), question, kind_of_limit.proposal, parse)
            continue
        only_user = interview.value(answers.limits.get(key), question, None, parse)
        if only_user.content is not None:
            found[key] = Value(only_user.content)
    return found
