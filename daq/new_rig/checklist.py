"""Checklist of the steps before the thrusters of a rig turn, as a page in Markdown with the commands of this rig."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from seatrial.daq.rig import LOAD_CELLS, UNCHECKED, Rig, Thruster

NOW = "$(date +%m%d-%H%M%S)"  # of a shell, in the names of logs, so that a line can be repeated
FIRST_N = 0.1  # largest command of the first turns


def checklist(rig: Rig, kind: str) -> str:
    """Return the checklist of a rig: the steps in their order, with a box to tick for each.

    Parameters
    ----------
    rig
        The rig, read from its file. The commands name the file as it is named in its own folder.
    kind
        "boat" or "bench".

    Returns
    -------
    str
        Text in Markdown. A rig without a thruster has only the steps at rest.
    """
    name = shlex.quote(rig.path.name)
    head = [
        f"# Checklist: {rig.name}",
        "",
        f"Do these steps in this order, in the folder of `{rig.path.name}`. Propellers injure people: no step of",
        "parts 1 and 2 commands thrust, and nobody is near a propeller in the others.",
    ]
    parts = [("At the desk, without thrust", _desk_steps(rig, name, kind))]
    if rig.thrusters:
        parts.append(("What stops the thrust without this computer", _stop_steps(rig, name)))
        parts.append(("The first turns, at low thrust", _first_turns(rig, name, kind)))
        parts.append(("The first run", _bench_run(rig, name) if kind == "bench" else _boat_run(rig, name)))
    text = list(head)
    for number, (title, steps) in enumerate(parts, start=1):
        text += ["", f"## {number}. {title}", "", *(f"- [ ] {step}" for step in steps)]
    if not rig.thrusters:
        text += ["", "The rig has no [[thruster]]: seatrial logs these devices and commands no thrust."]
    return "\n".join(text) + "\n"


def _new_log(kind: str) -> str:
    """Return the name of a log for a shell: with date and time, because a log is never overwritten."""
    return f'"logs/{kind}-{NOW}.mcap"'


def _newest_log(kind: str) -> str:
    """Return the name of the newest log that a line with `_new_log` has written, for a shell."""
    return f'"$(ls -t logs/{kind}-[0-9]*.mcap | head -n 1)"'


def _desk_steps(rig: Rig, name: str, kind: str) -> list[str]:
    """Return the steps that need the devices but no thrust."""
    steps = []
    if rig.thrusters:
        steps.append("The propellers are off, or the motors have no power.")
    n_unchecked = sum(UNCHECKED in line or "# caveat" in line for line in rig.text.splitlines())
    if n_unchecked:
        steps.append(
            f'Every line of `{rig.path.name}` with "{UNCHECKED}" or "caveat" is measured or looked up, and the mark is '
            f"removed ({n_unchecked} lines when this list was written): `grep -nE '{UNCHECKED}|caveat' {name}`"
        )
    serial = [d for d in rig.devices if d.port.removeprefix("slcan:").startswith("/")]
    if serial:
        steps.append("This user may open serial ports: `sudo usermod -aG dialout $USER`, then log in again.")
    for bus in dict.fromkeys(d.port.partition(":")[2] for d in rig.devices if d.port.startswith("socketcan:")):
        rate = next(d.bitrate for d in rig.devices if d.port == f"socketcan:{bus}")
        steps.append(f"The CAN bus is up: `sudo ip link set {bus} up type can bitrate {rate}`")
    steps.append(f"No fault is reported: `seatrial check {name}`")
    steps.append(f"A log at rest is recorded: `seatrial log {name} --duration 60 --out {_new_log('still')}`")
    steps.append(f"Its rates and gaps are as expected: `seatrial info {_newest_log('still')}`")
    if any(device.protocol in LOAD_CELLS for device in rig.devices):
        steps.append(
            "The load cell is calibrated: a known mass gives its weight in the live table of `seatrial log`, and a "
            "pull in the direction of forward thrust gives a positive force."
        )
    if kind == "boat":
        steps.append("The heading stays where it is when the power of a motor is switched on and off (live table).")
    return steps


def _stop_steps(rig: Rig, name: str) -> list[str]:
    """Return the steps that prove that the thrust ends when the computer fails."""
    steps = [
        "A kill switch cuts the power of the motors without seatrial. It was tested today, and a person holds it.",
    ]
    by_autopilot = [t for t in rig.thrusters if t.output is not None]
    by_bus = [t for t in rig.thrusters if t.output is None]
    if by_bus:
        times = ", ".join(f"{t.name} (node {t.node}) {t.timeout_s:g} s" for t in by_bus)
        steps.append(f"The time-out that is set in each speed controller is that of the rig: {times}.")
    if by_autopilot:
        devices = ", ".join(dict.fromkeys(t.device for t in by_autopilot))
        steps.append(
            f"The failsafe parameters of {devices} are accepted: `seatrial check {name}` reports no fault of the "
            "autopilot."
        )
    limits = [
        f"{key} {value:g}"
        for key in ("n_max", "current_a", "temperature_c", "voltage_min_v", "radius_m", "force_n")
        if (value := getattr(rig.limits, key)) is not None
    ]
    steps.append(
        f"The limits are yours ({', '.join(limits)}), and `seatrial check {name}` names a source for each of them."
    )
    return steps


def _first_turns(rig: Rig, name: str, kind: str) -> list[str]:
    """Return the steps of the first turns at low thrust. Behind an autopilot they include the link test."""
    autopilot = any(t.output is not None for t in rig.thrusters)
    arm = " --arm" if autopilot else ""
    n = min(FIRST_N, rig.limits.n_max)
    if kind == "bench":
        steps = ["The thruster and its mount are fixed, and the propeller is under water and clear."]
        for thruster in rig.thrusters:
            steps.append(
                f"{thruster.name} turns forward when forward is commanded, and the force is then positive: "
                f"`seatrial bench steps {name} --thruster {thruster.name} --n-max {n:g}{arm} --out "
                f"{_new_log(f'first-{thruster.name}')}`"
            )
    else:
        steps = ["The boat is in the water and free to move, nobody is in the water, and the area is clear."]
        steps.append(
            f"Each thruster turns alone and in the expected direction ({_sides(rig.thrusters)}): "
            f"`seatrial check {name} --actuators --thrust {n:g}{arm} --out {_new_log('actuators')}`"
        )
    if autopilot:
        steps.append(f"The link test is passed: `seatrial check {name} --actuators --link-test{arm}`")
    else:
        steps.append(
            'The thrust ends within the time-out when the plug of the bus is pulled at low thrust (page "Your own '
            'boat", At the jetty).'
        )
    steps.append("A thruster that stays at rest has a dead band: repeat its step with twice the command.")
    steps.append("Set `reversed = true` for a thruster that turns the wrong way, and repeat this part.")
    return steps


def _sides(thrusters: Sequence[Thruster]) -> str:
    """Return for each thruster of a boat how the boat turns when it drives forward, from its position."""
    words = []
    for thruster in thrusters:
        y = thruster.position_m[1]
        turn = "to starboard" if y < 0.0 else "to port" if y > 0.0 else "straight on"
        words.append(f"{thruster.name} forward drives {turn}")
    return ", ".join(words)


def _bench_run(rig: Rig, name: str) -> list[str]:
    """Return the steps of the first run of a bench: all set-points, and the model of each thruster."""
    steps = []
    arm = " --arm" if any(t.output is not None for t in rig.thrusters) else ""
    for thruster in rig.thrusters:
        log = f"bench-{thruster.name}"
        steps.append(f"`seatrial bench all {name} --thruster {thruster.name}{arm} --out {_new_log(log)}`")
        steps.append(f"`seatrial ident thruster {_newest_log(log)} --out {thruster.name}`")
    return steps


def _boat_run(rig: Rig, name: str) -> list[str]:
    """Return the steps of the first run of a boat: a mission to estimate and one to validate, and the fit."""
    if len(rig.thrusters) != 2:
        return [
            f"Write a mission for the thrusters {', '.join(t.name for t in rig.thrusters)} (page mission.toml), and "
            f"check it: `seatrial check {name} --mission mission.toml`",
            f"`seatrial mission run mission.toml {name} --out {_new_log('run')}`",
        ]
    left, right = sorted(rig.thrusters, key=lambda t: t.position_m[1])
    behind = any(t.output is not None for t in rig.thrusters)
    arm, model = (" --arm", " --model nomoto") if behind else ("", "")
    steps = []
    for title, seed, seconds in (("estimation", 1, 400), ("validation", 2, 250)):
        steps.append(
            f"`seatrial mission generate --kind mixed --seconds {seconds} --seed {seed} --n-max {rig.limits.n_max:g} "
            f"--thrusters {left.name},{right.name} --out {title}.toml`"
        )
        steps.append(f"`seatrial check {name} --mission {title}.toml`")
        steps.append(f"`seatrial mission run {title}.toml {name}{arm} --out {_new_log(title)}`")
    estimation, validation = _newest_log("estimation"), _newest_log("validation")
    steps.append(f"`seatrial ident vehicle {estimation} --validate {validation}{model} --out vehicle`")
    return steps
