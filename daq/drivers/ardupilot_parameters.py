"""Check of the parameters of ArduPilot Rover on which thrusters behind the autopilot depend. It changes no parameter.

With PILOT_STEER_TYPE 1 the two channels command the left and the right thruster directly, as if a pilot moved two
paddles, and the outputs follow them within 27 ms. Sources: measurements with Rover 4.7, and its documentation
(ardupilot.org/rover/docs/parameters.html).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from seatrial.daq.errors import first_names
from seatrial.daq.rig import Thruster

TWO_PADDLES = 1  # PILOT_STEER_TYPE
# SERVOn_FUNCTION: throttle left, throttle right. Function 70, throttle, would output the mean of both channels.
LEFT, RIGHT = 73.0, 74.0
# Function -> parameter with the channel of that side, and its factory value.
PADDLES = {LEFT: ("RCMAP_ROLL", 1.0), RIGHT: ("RCMAP_THROTTLE", 3.0)}
OVERRIDE_MAX_S = 1.0  # largest allowed RC_OVERRIDE_TIME
STATION_MAX_S = 5.0  # largest allowed FS_GCS_TIMEOUT and FS_TIMEOUT; the factory value of FS_GCS_TIMEOUT
HOLD, TERMINATE = 2.0, 5.0  # FS_ACTION
IGNORES_OVERRIDES = 1 << 1  # bit of RC_OPTIONS
GROUND_STATION_NAMES = ("MAV_GCS_SYSID", "SYSID_MYGCS")  # name in Rover 4.7 and later, name in earlier versions
# Parameters that some versions of Rover 4 lack. Each version with MAV_GCS_SYSID has them.
NEWER_PARAMETERS = frozenset({"FS_OPTIONS", "FS_GCS_TIMEOUT", "MANUAL_STR_EXPO", "MOT_THST_ASYM"})
# Parameters that determine when thrust ends after the loss of the link, and what the boat does then.
LINK_LOSS_PARAMETERS = (
    *("RC_OVERRIDE_TIME", "RC_OPTIONS", "PILOT_STEER_TYPE", "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "FS_THR_ENABLE"),
    *("FS_THR_VALUE", "FS_TIMEOUT", "FS_ACTION", "FS_OPTIONS", *GROUND_STATION_NAMES),
)
# Other parameters that can make the boat drive by itself. A Rover without battery monitor or fence may lack them.
FAILSAFE_PARAMETERS = ("BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "FENCE_ENABLE", "FENCE_ACTION")
STOPPING_ACTIONS = (0.0, 2.0, 5.0)  # allowed actions of these failsafes: none, hold, terminate


class ParameterMismatch(NamedTuple):
    """Parameter of the autopilot that has a wrong value or was not answered.

    Attributes
    ----------
    name
        Name of the parameter.
    value
        Value in the autopilot; None if it was not answered.
    wanted
        The required value, in words.
    why
        The consequence of the wrong value.
    fatal
        Whether thrust must not be commanded with this value.
    """

    name: str
    value: float | None
    wanted: str
    why: str
    fatal: bool

    def __str__(self) -> str:
        """Return the wrong or unanswered parameter in one line for the user: name, value, required value, effect.

        The line about an unanswered one (`value` None) has only the name and advice on the link.
        """
        if self.value is None:
            return (
                f"{self.name} was not answered by the autopilot; the link may lose messages: repeat closer to the "
                "boat, or with lower rates in the rig"
            )
        return f"{self.name} is {self.value:g}, wanted {self.wanted}: {self.why}"


class ParameterLine(NamedTuple):
    """Line for the user about one wrong parameter, or about unanswered ones.

    Attributes
    ----------
    text
        The line. About unanswered parameters it ends with an advice.
    fatal
        Whether these parameters forbid thrust.
    is_answered
        Whether the autopilot sent a value, which is wrong.
    """

    text: str
    fatal: bool
    is_answered: bool


def parameter_lines(mismatches: Sequence[ParameterMismatch]) -> list[ParameterLine]:
    """Return lines for the user about parameters of an autopilot. Unanswered parameters share a line.

    Parameters
    ----------
    mismatches
        The wrong and the unanswered parameters of an autopilot.

    Returns
    -------
    list of ParameterLine
        The wrong ones one by one, then one line on the unanswered ones that forbid thrust, and one on the others. Each
        names the first parameters and the number of all.
    """
    lines = [ParameterLine(str(m), m.fatal, True) for m in mismatches if m.value is not None]
    for fatal in (True, False):
        unanswered = [m for m in mismatches if m.value is None and m.fatal is fatal]
        if len(unanswered) == 1:
            lines.append(ParameterLine(str(unanswered[0]), fatal, False))
        elif unanswered:
            advice = str(unanswered[0]).partition("; ")[2]
            names = first_names([m.name for m in unanswered])
            text = f"{len(unanswered)} parameters were not answered by the autopilot ({names})"
            lines.append(ParameterLine(f"{text}; {advice}", fatal, False))
    return lines


def parameter_names(thrusters: Sequence[Thruster]) -> tuple[str, ...]:
    """Return the names of the ArduPilot parameters on which the thrusters behind one autopilot depend, each once.

    They are requested from the autopilot. A thruster without an RC output, which is not behind an autopilot, adds no
    names; parameters of the whole vehicle are always in the result.
    """
    names = [*LINK_LOSS_PARAMETERS, "MOT_SLEWRATE", "MOT_THR_MIN", "MOT_THST_EXPO", "MOT_THST_ASYM", "MOT_THR_MAX"]
    names += ["MANUAL_STR_EXPO", "SCHED_LOOP_RATE", *FAILSAFE_PARAMETERS, *(name for name, _ in PADDLES.values())]
    for thruster in thrusters:
        if thruster.output is None:
            continue
        channel, servo = f"RC{thruster.output.rc_channel}", f"SERVO{thruster.node}"
        names += [f"{channel}_{end}" for end in ("MIN", "TRIM", "MAX", "DZ", "REVERSED")]
        names += [f"{servo}_{end}" for end in ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED")]
    return tuple(dict.fromkeys(names))


def link_loss_hash(parameters: Mapping[str, float]) -> str:
    """Return the SHA-256, in hexadecimal, of the parameters that determine the reaction to a lost link.

    Other parameters, and parameters that are missing, do not count. The hash shows whether these parameters have
    changed between a link test and a run.
    """
    text = "\n".join(f"{name}={parameters[name]:g}" for name in LINK_LOSS_PARAMETERS if name in parameters)
    return hashlib.sha256(text.encode()).hexdigest()


def check_parameters(
    parameters: Mapping[str, float], thrusters: Sequence[Thruster], own_system: int
) -> tuple[ParameterMismatch, ...]:
    """Compare the parameters of an autopilot with those that a run needs. Return the wrong and the unanswered ones.

    Parameters
    ----------
    parameters
        Values of the answered parameters by name.
    thrusters
        Thrusters behind the autopilot.
    own_system
        System id of our ground station.

    Returns
    -------
    tuple of ParameterMismatch
        The wrong parameters, and those that this version of Rover has but that were not answered. Those that forbid
        thrust (`fatal`) are first. An unanswered one forbids it, except those of battery failsafe and fence.
    """
    mismatches = [*_check_failsafes(parameters, own_system), *_check_mixing(parameters)]
    for thruster in thrusters:
        mismatches += _check_thruster(parameters, thruster)
    reported = {mismatch.name for mismatch in mismatches}
    why = "a parameter without an answer may have a wrong value"
    mismatches += [
        ParameterMismatch(name, None, "an answer", why, name not in FAILSAFE_PARAMETERS)
        for name in _required_names(parameters, thrusters)
        if name not in parameters and name not in reported
    ]
    return tuple(sorted(mismatches, key=lambda mismatch: not mismatch.fatal))


def _required_names(p: Mapping[str, float], thrusters: Sequence[Thruster]) -> list[str]:
    """Return the names of the needed parameters that this version of ArduPilot Rover should have.

    If one of them is not answered, the message was probably lost. Only those of battery failsafe and fence may be
    lacking. `p` are the values of the answered parameters by name; they show whether the version is 4.7 or newer.
    `thrusters` are those behind the autopilot. Parameters that other functions of this module check for an answer, and
    SCHED_LOOP_RATE, are left out.
    """
    newer, _ = GROUND_STATION_NAMES
    # `_check_failsafes` checks one of the GROUND_STATION_NAMES, and `_check_thruster` the RCMAP parameter of its side.
    # SCHED_LOOP_RATE has no influence on thrust.
    may_lack = {*GROUND_STATION_NAMES, *(name for name, _ in PADDLES.values()), "SCHED_LOOP_RATE"}
    may_lack |= frozenset() if newer in p else NEWER_PARAMETERS
    return [name for name in parameter_names(thrusters) if name not in may_lack]


def _check_failsafes(p: Mapping[str, float], own_system: int) -> list[ParameterMismatch]:
    """Return the wrong parameters of failsafes, RC overrides and ground station of an autopilot.

    `p` are the values of the answered parameters by name, and `own_system` is the system id of our ground station. If
    they are not answered, RC_OVERRIDE_TIME, FS_GCS_ENABLE, FS_THR_ENABLE, FS_ACTION and the id of the ground station
    count as wrong, the others as right. FENCE_ACTION is checked only if the fence is enabled. Each of them forbids
    thrust (`fatal`).
    """
    mismatches = []
    override = p.get("RC_OVERRIDE_TIME")
    if override is None or not 0.0 < override <= OVERRIDE_MAX_S:
        why = "the thrusters continue for this time after the end of this program (-1: without end)"
        mismatches.append(
            ParameterMismatch("RC_OVERRIDE_TIME", override, f"above 0, at most {OVERRIDE_MAX_S:g} s", why, True)
        )
    failsafe = p.get("FS_GCS_ENABLE")
    if failsafe != 1.0:
        mismatches.append(
            ParameterMismatch(
                "FS_GCS_ENABLE", failsafe, "1", "without it the boat does not stop if the ground station is lost", True
            )
        )
    throttle = p.get("FS_THR_ENABLE")
    if throttle != 1.0:
        why = "without it the last command is held without end if no transmitter has been received"
        mismatches.append(ParameterMismatch("FS_THR_ENABLE", throttle, "1", why, True))
    action = p.get("FS_ACTION")
    if action not in (HOLD, TERMINATE):
        why = (
            "after a lost link the boat does not stop" if not action else "after a lost link the boat drives by itself"
        )
        mismatches.append(ParameterMismatch("FS_ACTION", action, "2 (hold) or 5 (terminate)", why, True))
    failsafes = {"BATT_FS_LOW_ACT": "with a low battery", "BATT_FS_CRT_ACT": "with an empty battery"}
    if p.get("FENCE_ENABLE", 0.0) != 0.0:
        failsafes["FENCE_ACTION"] = "at its fence"
    for name, when in failsafes.items():
        if p.get(name, 0.0) not in STOPPING_ACTIONS:
            why = f"{when} the boat drives by itself"
            mismatches.append(ParameterMismatch(name, p[name], "0, 2 (hold) or 5 (terminate)", why, True))
    for name, most in (("FS_GCS_TIMEOUT", STATION_MAX_S), ("FS_TIMEOUT", STATION_MAX_S)):
        if name in p and p[name] > most:
            why = "the loss of the ground station is detected only after this time"
            mismatches.append(ParameterMismatch(name, p[name], f"at most {most:g} s", why, True))
    options = int(p.get("RC_OPTIONS", 0.0))
    if options & IGNORES_OVERRIDES:
        why = "with bit 1 set the autopilot ignores all our commands"
        mismatches.append(ParameterMismatch("RC_OPTIONS", float(options), f"{options & ~IGNORES_OVERRIDES}", why, True))
    ground = p.get("MAV_GCS_SYSID", p.get("SYSID_MYGCS"))
    if ground != float(own_system):
        name = "SYSID_MYGCS" if "SYSID_MYGCS" in p else "MAV_GCS_SYSID"
        mismatches.append(
            ParameterMismatch(
                name, ground, str(own_system), "the autopilot obeys only this ground station (own_system_id)", True
            )
        )
    return mismatches


def _check_mixing(p: Mapping[str, float]) -> list[ParameterMismatch]:
    """Return the wrong parameters of mixing, ramps and curves between RC channels and servo outputs of an autopilot.

    `p` are the values of the answered parameters by name. Except for PILOT_STEER_TYPE, a missing one counts as right.
    MOT_SLEWRATE and MOT_THR_MIN, which distort steps and small commands, do not forbid thrust (`fatal`); the others do.
    """
    mismatches = []
    steer = p.get("PILOT_STEER_TYPE")
    if steer != TWO_PADDLES:
        why = "otherwise the channels are throttle and steering instead of left and right"
        mismatches.append(ParameterMismatch("PILOT_STEER_TYPE", steer, "1", why, True))
    # A distortion of large commands forbids thrust, because the run would end when the guard detects it. A distortion
    # of steps and small commands is only reported.
    rows = (
        ("MOT_SLEWRATE", 0.0, "the autopilot would change each step to a ramp", False),
        ("MOT_THR_MIN", 0.0, "the autopilot would leave out small thrusts", False),
        ("MOT_THST_EXPO", 0.0, "the autopilot would distort the thrust curve", True),
        ("MOT_THST_ASYM", 1.0, "the autopilot would scale commands in reverse", True),
        ("MOT_THR_MAX", 100.0, "the autopilot would limit large commands", True),
        ("MANUAL_STR_EXPO", 0.0, "the autopilot would distort the difference of the commands", True),
    )
    mismatches += [
        ParameterMismatch(name, p[name], f"{required:g}", why, fatal)
        for name, required, why, fatal in rows
        if p.get(name, required) != required
    ]
    return mismatches


def _check_thruster(p: Mapping[str, float], thruster: Thruster) -> list[ParameterMismatch]:
    """Return the wrong parameters of the RC channel and the servo output of one thruster.

    The list is empty for a thruster without an output in the rig. `p` are the values of the answered parameters by
    name. Of the missing ones, those that must have the value of the rig (function, channel and pulse widths) count as
    wrong, the others as right. The channel is checked only with a right function, and FS_THR_VALUE only if the channel
    is that of RCMAP_THROTTLE. FS_THR_VALUE and the dead zone (DZ) do not forbid thrust (`fatal`); the others do.
    """
    output = thruster.output
    if output is None:
        return []
    mismatches = []
    servo, channel = f"SERVO{thruster.node}", f"RC{output.rc_channel}"
    function = p.get(f"{servo}_FUNCTION")
    if function not in PADDLES:
        why = f"output {thruster.node} must be the left or right throttle; passthrough would move it while disarmed"
        mismatches.append(ParameterMismatch(f"{servo}_FUNCTION", function, "73 (left) or 74 (right)", why, True))
    else:
        name, _ = PADDLES[function]
        if p.get(name) != output.rc_channel:
            why = f"{servo}_FUNCTION {function:g} follows this channel, so it must be rc_channel of {thruster.name}"
            mismatches.append(ParameterMismatch(name, p.get(name), str(output.rc_channel), why, True))
    ends = (("MIN", 0), ("TRIM", 1), ("MAX", 2))
    for prefix, pulses, key in ((channel, output.rc_us, "rc_us"), (servo, output.pwm_us, "pwm_us")):
        for end, k in ends:
            value = p.get(f"{prefix}_{end}")
            if value != pulses[k]:
                why = f"the rig has this value in {key} of thruster {thruster.name}; one of both is wrong"
                mismatches.append(ParameterMismatch(f"{prefix}_{end}", value, f"{pulses[k]:g}", why, True))
    threshold = p.get("FS_THR_VALUE", 0.0)
    if p.get("RCMAP_THROTTLE") == output.rc_channel and threshold >= min(output.rc_us):
        why = f"shorter pulses of {thruster.name} mean a lost transmitter, so reverse would start the failsafe"
        mismatches.append(ParameterMismatch("FS_THR_VALUE", threshold, f"below {min(output.rc_us):g}", why, False))
    reverses = "the autopilot would reverse only the command or only the output"
    dead_zone = "the autopilot would ignore small commands"
    rows = ((f"{channel}_DZ", dead_zone), (f"{channel}_REVERSED", reverses), (f"{servo}_REVERSED", reverses))
    for name, why in rows:
        if p.get(name, 0.0) != 0.0:
            mismatches.append(ParameterMismatch(name, p[name], "0", why, why == reverses))
    return mismatches
