"""Checks the parameters of ArduPilot Rover that thrusters behind it depend on. Changes nothing.

Measured on Rover 4.7 and read in its documentation (ardupilot.org/rover/docs/parameters.html): with PILOT_STEER_TYPE 1
the channels of two thrusters are what a pilot with two paddles moves, and the outputs follow them within 27 ms.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from seatrial.daq.rig import Thruster

TWO_PADDLES = 1
LEFT, RIGHT = 73.0, 74.0  # SERVOn_FUNCTION: throttle left, throttle right; of 70, throttle, both paddles have a half
PADDLES = {LEFT: ("RCMAP_ROLL", 1.0), RIGHT: ("RCMAP_THROTTLE", 3.0)}  # the channel of each side, and as delivered
OVERRIDE_MAX_S = 1.0
STATION_MAX_S = 5.0  # FS_GCS_TIMEOUT as delivered
HOLD, TERMINATE = 2.0, 5.0  # FS_ACTION
IGNORES_OVERRIDES = 1 << 1  # of RC_OPTIONS
GROUND_STATION_NAMES = ("MAV_GCS_SYSID", "SYSID_MYGCS")  # from 4.7 on, and before
# Not in every Rover 4, but in each that says MAV_GCS_SYSID.
YOUNG = frozenset({"FS_OPTIONS", "FS_GCS_TIMEOUT", "MANUAL_STR_EXPO", "MOT_THST_ASYM"})
# What decides how soon thrust ends when we fall silent, and what the boat does then.
OF_LINK_LOSS = (
    *("RC_OVERRIDE_TIME", "RC_OPTIONS", "PILOT_STEER_TYPE", "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "FS_THR_ENABLE"),
    *("FS_THR_VALUE", "FS_TIMEOUT", "FS_ACTION", "FS_OPTIONS", *GROUND_STATION_NAMES),
)
# What else may make the boat drive by itself; one without battery monitor or fence may not answer them.
OF_FAILSAFES = ("BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "FENCE_ENABLE", "FENCE_ACTION")
STAYS = (0.0, 2.0, 5.0)  # of their actions: none, hold, terminate


class ParameterMismatch(NamedTuple):
    """One parameter with a wrong value, or that was not answered."""

    name: str
    value: float | None  # None: not answered
    wanted: str
    why: str
    fatal: bool  # no thrust may be commanded like this

    def __str__(self) -> str:
        if self.value is None:
            return f"{self.name} was not answered (a lossy link?): ask again, nearer, or with lower rates in the rig"
        return f"{self.name} is {self.value:g}, wanted {self.wanted}: {self.why}"


def parameter_names(thrusters: Sequence[Thruster]) -> tuple[str, ...]:
    """The parameters to ask for, for the thrusters behind one autopilot."""
    names = [*OF_LINK_LOSS, "MOT_SLEWRATE", "MOT_THR_MIN", "MOT_THST_EXPO", "MOT_THST_ASYM", "MOT_THR_MAX"]
    names += ["MANUAL_STR_EXPO", "SCHED_LOOP_RATE", *OF_FAILSAFES, *(name for name, _ in PADDLES.values())]
    for thruster in thrusters:
        if thruster.output is None:
            continue
        channel, servo = f"RC{thruster.output.rc_channel}", f"SERVO{thruster.node}"
        names += [f"{channel}_{end}" for end in ("MIN", "TRIM", "MAX", "DZ", "REVERSED")]
        names += [f"{servo}_{end}" for end in ("FUNCTION", "MIN", "TRIM", "MAX", "REVERSED")]
    return tuple(dict.fromkeys(names))


def link_loss_hash(parameters: Mapping[str, float]) -> str:
    """SHA-256 of the parameters that decide what a lost link does, to compare those of a test with those of a run."""
    text = "\n".join(f"{name}={parameters[name]:g}" for name in OF_LINK_LOSS if name in parameters)
    return hashlib.sha256(text.encode()).hexdigest()


def check_parameters(
    parameters: Mapping[str, float], thrusters: Sequence[Thruster], own_system: int
) -> tuple[ParameterMismatch, ...]:
    """The parameters that are wrong, those that forbid thrust first."""
    found = [*_safety(parameters, own_system), *_mixing(parameters)]
    for thruster in thrusters:
        found += _thruster(parameters, thruster)
    told = {finding.name for finding in found}
    found += [
        ParameterMismatch(name, None, "an answer", "what was not answered may be wrong", name not in OF_FAILSAFES)
        for name in _required(parameters, thrusters)
        if name not in parameters and name not in told
    ]
    return tuple(sorted(found, key=lambda finding: not finding.fatal))


def _required(p: Mapping[str, float], thrusters: Sequence[Thruster]) -> list[str]:
    """The parameters that this version has, so that no answer is a loss on the way and not a parameter that it lacks.

    `_safety` asks for one of the GROUND_STATION_NAMES, `_thruster` for the one of RCMAP that is its own, and no thrust
    depends on SCHED_LOOP_RATE.
    """
    newer, _ = GROUND_STATION_NAMES
    may_lack = {*GROUND_STATION_NAMES, *(name for name, _ in PADDLES.values()), "SCHED_LOOP_RATE"}
    may_lack |= frozenset() if newer in p else YOUNG
    return [name for name in parameter_names(thrusters) if name not in may_lack]


def _safety(p: Mapping[str, float], own_system: int) -> list[ParameterMismatch]:
    found = []
    override = p.get("RC_OVERRIDE_TIME")
    if override is None or not 0.0 < override <= OVERRIDE_MAX_S:
        why = "so long the thrusters run on when this program has died (-1: for ever)"
        found.append(
            ParameterMismatch("RC_OVERRIDE_TIME", override, f"above 0, at most {OVERRIDE_MAX_S:g} s", why, True)
        )
    failsafe = p.get("FS_GCS_ENABLE")
    if failsafe != 1.0:
        found.append(
            ParameterMismatch("FS_GCS_ENABLE", failsafe, "1", "without it a lost ground station stops nothing", True)
        )
    throttle = p.get("FS_THR_ENABLE")
    if throttle != 1.0:
        why = "without it the last override holds for ever where no transmitter was ever heard"
        found.append(ParameterMismatch("FS_THR_ENABLE", throttle, "1", why, True))
    action = p.get("FS_ACTION")
    if action not in (HOLD, TERMINATE):
        why = "a lost link stops nothing" if not action else "after a lost link the boat drives by itself"
        found.append(ParameterMismatch("FS_ACTION", action, "2 (hold) or 5 (terminate)", why, True))
    failsafes = {"BATT_FS_LOW_ACT": "with a low battery", "BATT_FS_CRT_ACT": "with an empty battery"}
    if p.get("FENCE_ENABLE", 0.0) != 0.0:
        failsafes["FENCE_ACTION"] = "at its fence"
    for name, when in failsafes.items():
        if p.get(name, 0.0) not in STAYS:
            why = f"{when} the boat drives by itself"
            found.append(ParameterMismatch(name, p[name], "0, 2 (hold) or 5 (terminate)", why, True))
    for name, most in (("FS_GCS_TIMEOUT", STATION_MAX_S), ("FS_TIMEOUT", STATION_MAX_S)):
        if name in p and p[name] > most:
            why = "so much later is a lost ground station noticed"
            found.append(ParameterMismatch(name, p[name], f"at most {most:g} s", why, True))
    options = int(p.get("RC_OPTIONS", 0.0))
    if options & IGNORES_OVERRIDES:
        why = "with bit 1 it ignores every command of ours"
        found.append(ParameterMismatch("RC_OPTIONS", float(options), f"{options & ~IGNORES_OVERRIDES}", why, True))
    ground = p.get("MAV_GCS_SYSID", p.get("SYSID_MYGCS"))
    if ground != float(own_system):
        name = "SYSID_MYGCS" if "SYSID_MYGCS" in p else "MAV_GCS_SYSID"
        found.append(
            ParameterMismatch(name, ground, str(own_system), "it obeys this ground station alone (own_system_id)", True)
        )
    return found


def _mixing(p: Mapping[str, float]) -> list[ParameterMismatch]:
    found = []
    steer = p.get("PILOT_STEER_TYPE")
    if steer != TWO_PADDLES:
        why = "else the channels are throttle and steering, and not left and right"
        found.append(ParameterMismatch("PILOT_STEER_TYPE", steer, "1", why, True))
    # A distortion of every large command would end the run as soon as it is seen; what bends small ones is reported.
    rows = (
        ("MOT_SLEWRATE", 0.0, "the autopilot would ramp every step", False),
        ("MOT_THR_MIN", 0.0, "the autopilot would jump over the smallest thrust", False),
        ("MOT_THST_EXPO", 0.0, "the autopilot would bend the thrust curve", True),
        ("MOT_THST_ASYM", 1.0, "the autopilot would stretch commands in reverse", True),
        ("MOT_THR_MAX", 100.0, "the autopilot would cut off large commands", True),
        ("MANUAL_STR_EXPO", 0.0, "the autopilot would bend the difference of the commands", True),
    )
    found += [
        ParameterMismatch(name, p[name], f"{want:g}", why, fatal)
        for name, want, why, fatal in rows
        if p.get(name, want) != want
    ]
    return found


def _thruster(p: Mapping[str, float], thruster: Thruster) -> list[ParameterMismatch]:
    output = thruster.output
    if output is None:
        return []
    found = []
    servo, channel = f"SERVO{thruster.node}", f"RC{output.rc_channel}"
    function = p.get(f"{servo}_FUNCTION")
    if function not in PADDLES:
        why = f"output {thruster.node} is no side of a two-paddle mix; passthrough would move it while disarmed"
        found.append(ParameterMismatch(f"{servo}_FUNCTION", function, "73 (left) or 74 (right)", why, True))
    else:
        name, _ = PADDLES[function]
        if p.get(name) != output.rc_channel:
            why = f"{servo}_FUNCTION {function:g} follows that channel, and rc_channel of {thruster.name} is another"
            found.append(ParameterMismatch(name, p.get(name), str(output.rc_channel), why, True))
    ends = (("MIN", 0), ("TRIM", 1), ("MAX", 2))
    for prefix, pulses, key in ((channel, output.rc_us, "rc_us"), (servo, output.pwm_us, "pwm_us")):
        for end, k in ends:
            value = p.get(f"{prefix}_{end}")
            if value != pulses[k]:
                why = f"{key} of thruster {thruster.name} in the rig says so; one of both is wrong"
                found.append(ParameterMismatch(f"{prefix}_{end}", value, f"{pulses[k]:g}", why, True))
    threshold = p.get("FS_THR_VALUE", 0.0)
    if p.get("RCMAP_THROTTLE") == output.rc_channel and threshold >= min(output.rc_us):
        why = f"pulses of {thruster.name} below it are a lost transmitter, so reverse is a failsafe"
        found.append(ParameterMismatch("FS_THR_VALUE", threshold, f"below {min(output.rc_us):g}", why, False))
    turns = "the sign of the command or of the output alone turns"
    dead = "a dead zone around neutral"
    for name, why in ((f"{channel}_DZ", dead), (f"{channel}_REVERSED", turns), (f"{servo}_REVERSED", turns)):
        if p.get(name, 0.0) != 0.0:
            found.append(ParameterMismatch(name, p[name], "0", why, why == turns))
    return found
