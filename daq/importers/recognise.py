"""Tables of known foreign signals: messages of ROS, mavros, PX4 and seatrial's decoders, and names of columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from seatrial.daq.importers.table import Column, Table
from seatrial.daq.importers.units import UNITS

UNCHOSEN_RANK = (
    5  # added to the rank of set-points and of the truth of a simulator; a candidate of this rank is not chosen
)


class Candidate(NamedTuple):
    """Signals of one table that a guessed import map could contain together.

    Attributes
    ----------
    group : str
        Quantity: position, velocity, body, heading, rate, acceleration, drive, force, ... Of the candidates with the
        same signal the one with the lowest rank is preferred.
    rank : int
        Preference, the lowest first: 0 a sensor, then an estimate. A rank of 5 (`UNCHOSEN_RANK`) or more is never
        chosen, for example that of set-points and of the truth of a simulator.
    table : Table
        Table of the columns.
    signals : tuple of MapSignal
        Signals that the map would contain.
    caveat : str
        What is uncertain in the signals, for a comment in the map; "" if there is none.
    quantity : frozenset of str
        Words that name a thruster's quantity, for example {"motor", "rpm"}. Left and right must have the same words;
        empty for no condition.
    """

    group: str  # position, velocity, body, heading, ...; only the best candidate of a group is chosen
    rank: int  # lower is better: a sensor before an estimate, an estimate before the truth of a simulator
    table: Table
    signals: tuple[MapSignal, ...]
    caveat: str = ""
    quantity: frozenset[str] = frozenset()  # of thrusters: left and right must have the same; empty: no condition


class MapSignal(NamedTuple):
    """Signal that a guessed import map could contain: its name, its columns and their unit.

    Attributes
    ----------
    name : str
        Name of the signal in models.
    columns : tuple of str
        Its columns.
    unit : str
        Unit of the column; "" for a signal that is computed from several columns.
    make : str
        Quantity that is computed from several columns, as in a map; "" for a single column.
    extra : str
        Further keys of the map, as TOML.
    full : float
        Number of the column that becomes 1, if it is a guess from the largest number of the source; 0 if it is not.
    at_command : float
        Largest command of the source, if ``full`` is the largest number divided by it; 0 if it is not.
    is_given : bool
        Whether the user gave ``full``, so that it is no guess.
    """

    name: str  # in models
    columns: tuple[str, ...]
    unit: str
    make: str = ""
    extra: str = ""  # further keys, as TOML
    full: float = 0.0  # number that becomes 1, if it is a guess from the numbers
    at_command: float = 0.0  # largest command, by which the largest number was divided for it
    is_given: bool = False  # whether the user gave `full`


Row = tuple[str, int, tuple[MapSignal, ...]]  # group, rank and signals of a candidate


def _vector_row(group: str, names: str, fields: str, unit: str, rank: int, extra: str = "") -> Row:
    """Return an entry (group, rank, signals) of the table of known messages, for fields that are signals of a model.

    `group` is the quantity, for example "velocity". Of several entries of a group the lowest `rank` is preferred.
    `names` are the signals and `fields` the message fields, both separated by blanks, as "x y" and "position.x
    position.y". `unit` is the unit of the fields. `extra` are further keys of the import map.
    """
    return (
        group,
        rank,
        tuple(MapSignal(n, (f,), unit, "", extra) for n, f in zip(names.split(), fields.split(), strict=True)),
    )


def _heading_row(prefix: str, rank: int, names: str = "x y z w") -> Row:
    """Return an entry (group, rank, signals) of the table of known messages, for the heading in a quaternion.

    The message fields of the quaternion are `prefix` followed by the `names`, in the order x, y, z, w. A lower `rank`
    is preferred.
    """
    fields = tuple(f"{prefix}{axis}" for axis in names.split())
    return "heading", rank, (MapSignal("psi", fields, "", "yaw", 'angle = "unwrap"'),)


def _fix_row(lat: str, lon: str, unit: str, rank: int) -> Row:
    """Return an entry (group, rank, signals) of the table of known messages, for a position in latitude and longitude.

    `lat` and `lon` are the message fields, and `unit` is that of both, for example "deg" or "degE7". A lower `rank` is
    preferred.
    """
    extra = "" if unit == "deg" else f'units = ["{unit}", "{unit}"]'
    signals = (MapSignal("x", (lat, lon), "", "north", extra), MapSignal("y", (lat, lon), "", "east", extra))
    return "position", rank, signals


IMU_PARTS = ("orientation", "angular_velocity", "linear_acceleration")
NOT_MEASURED = -1.0  # first covariance of a part of a ROS Imu that is not measured
_Q = "q[1] q[2] q[3] q[0]"  # PX4 writes w first
PULSE_REST, PULSE_RANGE = 1500.0, 400.0  # us; usual pulse at rest, and from there to full command
REST_WITHIN = 30.0  # us; the trim of an output is seldom farther from 1500 us
LEAST_AT_REST = 0.1  # share of the pulses; a value that fewer have is no rest
RIVAL_AT_REST = 0.25  # of the number of the most frequent value; with as many pulses of 1500 us the rest is not clear


def pulse_keys(rest: float = PULSE_REST) -> str:
    """Return the keys of an import map that convert pulses of an output [us] to commands, as TOML text.

    The pulse ``rest`` becomes 0, and a pulse 400 us above it 1. No pulse (0) means that the thruster stops.
    """
    keys = f"scale = {1.0 / PULSE_RANGE:.9g}, offset = {0.0 - rest / PULSE_RANGE:.9g}, missing = 0, missing_is = 0, "
    return keys + 'role = "input"'


PULSES = pulse_keys()
OUTPUT = f'{PULSES}, hold = "sampled"'  # an output that an autopilot reports at a fixed rate
_UNWRAP = 'angle = "unwrap"'
# Types of messages -> (group, rank, signals). For ROS the type without its package, for PX4 the name of the topic.
KNOWN: dict[str, tuple[Row, ...]] = {
    "NavSatFix": (_fix_row("latitude", "longitude", "deg", 0),),
    "Imu": (
        _heading_row("orientation.", 0),
        _vector_row("rate", "r", "angular_velocity.z", "rad/s", 0),
        _vector_row("acceleration", "ax ay", "linear_acceleration.x linear_acceleration.y", "m/s2", 0),
    ),
    "Odometry": (
        _vector_row("position", "x y", "pose.pose.position.x pose.pose.position.y", "m", 1),
        _heading_row("pose.pose.orientation.", 1),
        _vector_row("body", "u v", "twist.twist.linear.x twist.twist.linear.y", "m/s", 1),
        _vector_row("rate", "r", "twist.twist.angular.z", "rad/s", 1),
    ),
    "PoseStamped": (
        _vector_row("position", "x y", "pose.position.x pose.position.y", "m", 1),
        _heading_row("pose.orientation.", 1),
    ),
    "PoseWithCovarianceStamped": (
        _vector_row("position", "x y", "pose.pose.position.x pose.pose.position.y", "m", 1),
        _heading_row("pose.pose.orientation.", 1),
    ),
    "TransformStamped": (
        _vector_row("position", "x y", "transform.translation.x transform.translation.y", "m", 2),
        _heading_row("transform.rotation.", 2),
    ),
    "Pose": (_vector_row("position", "x y", "position.x position.y", "m", 1), _heading_row("orientation.", 1)),
    "Pose2D": (
        _vector_row("position", "x y", "x y", "m", 1),
        _vector_row("heading", "psi", "theta", "rad", 1, _UNWRAP),
    ),
    "vehicle_local_position": (
        _vector_row("position", "x y", "x y", "m", 1),
        _vector_row("velocity", "vx vy", "vx vy", "m/s", 1),
        _vector_row("heading", "psi", "heading", "rad", 2, _UNWRAP),
    ),
    "vehicle_odometry": (
        _vector_row("position", "x y", "position[0] position[1]", "m", 2),
        _heading_row("", 2, _Q),
        _vector_row("velocity", "vx vy", "velocity[0] velocity[1]", "m/s", 2),
    ),
    "vehicle_attitude": (_heading_row("", 0, _Q),),
    "vehicle_angular_velocity": (_vector_row("rate", "r", "xyz[2]", "rad/s", 0),),
    "vehicle_acceleration": (_vector_row("acceleration", "ax ay", "xyz[0] xyz[1]", "m/s2", 0),),
    "sensor_combined": (
        _vector_row("rate", "r", "gyro_rad[2]", "rad/s", 1),
        _vector_row("acceleration", "ax ay", "accelerometer_m_s2[0] accelerometer_m_s2[1]", "m/s2", 1),
    ),
    "sensor_gps": (
        _fix_row("latitude_deg", "longitude_deg", "deg", 0),
        _fix_row("lat", "lon", "degE7", 0),
        _vector_row("velocity", "vx vy", "vel_n_m_s vel_e_m_s", "m/s", 0),
    ),
    "actuator_motors": (
        _vector_row("drive", "n_left n_right", "control[1] control[0]", "1", 0, 'role = "input", hold = "sampled"'),
    ),
    "actuator_outputs": (
        _vector_row("drive", "n_left n_right", "output[1] output[0]", "1", 2, OUTPUT),
    ),
    "RCOut": (
        _vector_row("drive", "n_left n_right", "channels[0] channels[2]", "1", 2, OUTPUT),
    ),
    "Ahrs": (
        _vector_row("heading", "psi", "yaw", "rad", 0, _UNWRAP),
        _vector_row("rate", "r", "r", "rad/s", 0),
        _vector_row("acceleration", "ax ay", "ax ay", "m/s2", 0),
    ),
    "Gnss": (_fix_row("lat", "lon", "deg", 0), _vector_row("velocity", "vx vy", "vel_n vel_e", "m/s", 0)),
}  # fmt: skip
BODY_FRD = 3  # velocity_frame of PX4's vehicle_odometry; NED is 1
KNOWN["vehicle_gps_position"] = KNOWN["sensor_gps"]
CAVEATS = {
    "actuator_motors": "PX4's motors 1 and 2 are assumed to be right and left, as on its differential rovers",
    "actuator_outputs": "outputs 1 and 2 are assumed to be right and left",
    "TransformStamped": "a pose of /tf: the bag does not contain its source and its rate of new values",
    "RCOut": "outputs 1 and 3 are assumed to be left and right (ArduPilot's default)",
}
SETPOINT = re.compile(
    r"(?i)setpoint|desired|target|goal|reference|cmd_vel|/cmd/|waypoint|groundtruth|ground_truth|_sp$"
)
_EARTH = re.compile(r"(?i)gps|gnss|navsat|fix|velocity_local|vel_ned|vel_enu")
_EARTH_FRAMES = {"map", "odom", "world", "earth", "utm"}
# Meaning in a model -> names of columns, in small letters and without their unit
NAMES: dict[str, str] = {
    "x": "x x0 x_ned pos_x position_x x_pos north pos_n pos_north northing x_n north_m",
    "y": "y y0 y_ned pos_y position_y y_pos east pos_e pos_east easting y_e east_m",
    "psi": "psi yaw heading hdg yaw_ned compass compass_hdg heading_true true_heading",
    "r": "r gyro yaw_rate yawrate gyro_z gyr_z gz wz omega_z imu_gyro_z psi_dot rate_z angular_velocity_z yaw_speed",
    "u": "u surge surge_velocity surge_speed vel_surge u_body vx_body v_surge",
    "v": "v sway sway_velocity sway_speed vel_sway v_body vy_body v_sway",
    "vx": "vx vn v_n vel_n vel_north v_north velocity_north vx_ned vel_x velocity_x speed_x",
    "vy": "vy ve v_e vel_e vel_east v_east velocity_east vy_ned vel_y velocity_y speed_y",
    "speed": "speed sog speed_over_ground gps_speed ground_speed groundspeed",
    "course": "course cog track course_over_ground gps_course ground_course gcrs",
    "lat": "lat latitude gps_lat gps_latitude",
    "lon": "lon lng long longitude gps_lon gps_longitude",
    "ax": "ax acc_x accel_x accx imu_acc_x acceleration_x",
    "ay": "ay acc_y accel_y accy imu_acc_y acceleration_y",
}
_SI_OF = {"m": "x y", "m/s": "u v vx vy speed", "m/s2": "ax ay", "rad": "psi course lat lon", "rad/s": "r"}
_SI = {meaning: unit for unit, meanings in _SI_OF.items() for meaning in meanings.split()}
_MEANING = {name: meaning for meaning, names in NAMES.items() for name in names.split()}
# Sensor that may begin a name -> the meanings that it measures. The heading of a GNSS is left out, since it often is
# the course.
_OF_SATELLITES = frozenset(["x", "y", "vx", "vy", "speed", "course", "lat", "lon"])
_OF_GYROS = frozenset(["psi", "r", "ax", "ay"])
_OF_SENSOR = {
    **dict.fromkeys(("gps", "gnss", "rtk"), _OF_SATELLITES),
    **dict.fromkeys(("imu", "ahrs", "compass"), _OF_GYROS),
    **dict.fromkeys(("ins", "nav", "ekf"), (_OF_SATELLITES - {"course"}) | _OF_GYROS | {"u", "v"}),
}
# Words of a struct whose fields are not measured motions of the boat
_OF_OTHERS = frozenset([
    "accuracy", "air", "bias", "cmd", "command", "commands", "cov", "covariance", "current", "demand", "desired",
    "err", "error", "goal", "guidance", "limit", "pid", "planner", "ref", "reference", "residual", "setpoint",
    "sigma", "sp", "std", "target", "truth", "var", "variance", "water", "waypoint", "wind", "wp",
])  # fmt: skip
_LETTER_OF = {  # a single letter has its meaning only in a struct with one of these words: mag.x is no position
    "r": frozenset(["ahrs", "att", "attitude", "ekf", "gyro", "imu", "ins", "nav", "omega", "rate", "rates", "state"]),
    **dict.fromkeys("xy", frozenset(["local", "ned", "pos", "pose", "position"])),
    **dict.fromkeys("uv", frozenset(["body", "dvl", "vel", "velocity"])),
}
_UNITS = {  # units as written in names of columns -> units of maps
    "deg": "deg", "°": "deg", "degrees": "deg", "rad": "rad", "deg/s": "deg/s", "dps": "deg/s", "deg_s": "deg/s",
    "rad/s": "rad/s", "rads": "rad/s", "rad_s": "rad/s", "m": "m", "m/s": "m/s", "mps": "m/s", "m_s": "m/s", "kn": "kn",
    "kts": "kn", "knots": "kn", "km/h": "km/h", "m/s2": "m/s2", "m/s^2": "m/s2", "g": "g", "1/s": "rev/s", "hz": "Hz",
    "rpm": "rev/min", "pwm": "us", "newton": "N", "nm": "Nm", "s": "s", "ms": "ms", "us": "us", "ns": "ns", "-": "1",
    "sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "µs": "us", "μs": "us", "nsec": "ns",
    "n·m": "Nm", "min": "min", "minutes": "min", "h": "h", "hr": "h", "hours": "h", "days": "day", "day": "day",
    "pct": "%", "percent": "%", "per cent": "%",
}  # fmt: skip
_SUFFIX = re.compile(r"_(pct|percent|deg|degrees|rad|dps|deg_s|rads|rad_s|mps|m_s|kn|kts|knots|ms|us|ns|s|m)$")
# Words of a name -> units that may end this name, in small letters: force_N, supply_voltage_V. Without such a word, a
# letter at the end is rather an axis or a number than a unit.
_UNITS_OF_WORDS = {
    frozenset({"force", "thrust"}): {
        **dict.fromkeys(("n", "newton", "newtons"), "N"),
        **{unit: unit for unit in ("kgf", "kg", "gf", "g", "lbf", "lb")},
    },
    frozenset({"voltage", "vbat", "volts"}): {"v": "V", "volt": "V", "volts": "V", "mv": "mV"},
    frozenset({"current", "amps"}): {"a": "A", "amp": "A", "amps": "A", "ampere": "A", "ma": "mA"},
    frozenset({"power"}): {"w": "W", "watt": "W", "watts": "W"},
}
_BRACKET = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_LEFT, _RIGHT = {"left", "port", "l", "portside"}, {"right", "starboard", "stbd", "r", "sb"}
SIDES = _LEFT | _RIGHT
DRIVES = {
    "thr",
    "thrust",
    "thruster",
    "thrusters",
    "motor",
    "prop",
    "propeller",
    "pwm",
    "cmd",
    "command",
    "force",
    "rpm",
}
DRIVES |= {"throttle", "esc", "servo", "power", "n", "f", "engine", "shaft", "duty"}
_NOT_DRIVES = {"angle", "rudder", "azimuth", "pos", "position", "zero", "offset", "current", "voltage", "temperature"}
_NOT_DRIVES |= {"efficiency"}
_NOT_DRIVES |= {"effort", "torque", "std", "bias", "status", "min", "max", "temp", "sp", "sat", "sats", "satellites"}
_INPUT = "u"  # of control theory: beside a side it names a command, alone the velocity in surge
_LETTERS = {"n", "f", _INPUT}  # names of a thruster only if they stand alone or beside a side
SET_POINTS = {"setpoint", "desired", "target", "goal", "reference", "ref"}
FEWEST_JUMPS = 3  # jumps between small and wrapped numbers at least
FEWEST_LEVELS = 10  # different small numbers, and different wrapped numbers, at least
WRAPPED = "numbers up to {:.5g} are assumed to be negative speeds stored as 65536 - n; correct the telemetry"
_COMMANDS = SET_POINTS | {"cmd", "command", "pwm"}
_SPEEDS = {"rpm", "speed", "velocity", "shaft"}
_SPEED_UNITS = {"rev/min", "rev/s", "rad/s", "Hz"}
_FORCE_UNITS = {"N", "kgf", "lbf"}
_DRIVE_UNITS = {"", "1", "%", "us"} | _SPEED_UNITS | _FORCE_UNITS  # a power or a current is not an input


class Name(NamedTuple):
    """Parsed name of a column of a source file.

    Attributes
    ----------
    meaning : str
        Meaning in models, a key of `NAMES` such as "psi"; "" if unknown.
    unit : str
        Unit as in a map; "" if the name has no unit that fits its meaning.
    words : frozenset of str
        Words of the name, in small letters.
    plain : str
        Words joined by _, without the unit.
    no_unit : str
        Text in the place of a unit that is not a unit of this meaning; "" if there is none.
    """

    meaning: str  # a key of NAMES, "" if unknown
    unit: str  # as in a map, "" if the name has no unit that fits its meaning
    words: frozenset[str]  # in small letters
    plain: str  # words joined by _, without the unit
    no_unit: str = ""  # text in the place of a unit that is not a unit of this meaning


def unit_of(text: str) -> str:
    """Return a unit as import maps write it, for example "deg/s" for "dps"; "" if the unit is unknown.

    A unit in the spelling of import maps is returned unchanged. Other spellings are recognised in small and capital
    letters.
    """
    return text if text in UNITS else _UNITS.get(text.lower(), "")


def without_unit(column: str) -> str:
    """Return the name of a column without a text in brackets at its end, as a unit: "yaw [deg]" becomes "yaw"."""
    return _BRACKET.sub("", column).strip()


def read_name(column: str) -> Name:
    """Parse the name of a column of a source file: its meaning in a model, its unit and its words.

    Parameters
    ----------
    column
        The name, as "Heading [deg]" or "yaw_rate_dps".

    Returns
    -------
    Name
        The parts of the name. The unit is the text in brackets at the end, or else an ending such as _dps. The ending
        is used, and removed from `plain`, only if the name with the ending has no meaning. The endings of forces and
        of electrical quantities (_N, _V, _A, _W) are units only if the name has the quantity. Words are also separated
        where a capital letter follows a small one. The unit "ms" of a velocity is m/s. A speed with the unit of a shaft
        speed has no meaning.
    """
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])(?!(?<=_m)[AV]$)", "_", column)  # _mA and _mV are one word
    bracket = _BRACKET.search(column)
    behind = bracket.group(1).strip() if bracket else ""
    plain = re.sub(r"[^a-z0-9]+", "_", _BRACKET.sub("", spaced).lower()).strip("_")
    words = frozenset(plain.split("_"))
    meaning = _meaning_of(plain)
    if not meaning and (suffix := _SUFFIX.search(plain)) is not None:
        behind, plain = behind or suffix.group(1), plain[: suffix.start()]
        meaning = _meaning_of(plain)
    elif not meaning and not behind and (named := _unit_of_quantity(plain)):
        behind, plain = named, plain.rpartition("_")[0]
    unit = unit_of(behind)
    if unit == "ms" and _SI.get(meaning) == "m/s":  # m/s in a name that cannot contain a slash
        unit = "m/s"
    if meaning == "speed" and unit in _SPEED_UNITS:  # a shaft speed, not the speed of the boat
        meaning = ""
    fits = unit and (not meaning or UNITS.get(unit, ("",))[0] == _SI[meaning])
    return Name(meaning, unit if fits else "", words, plain, "" if fits or behind.isdecimal() else behind)


def _unit_of_quantity(plain: str) -> str:
    """Return the unit at the end of a name such as force_n, if the name has the quantity of this unit; else ""."""
    before, _, last = plain.rpartition("_")
    words = set(before.split("_"))
    return next((units[last] for names, units in _UNITS_OF_WORDS.items() if names & words and last in units), "")


def _meaning_of(plain: str) -> str:
    """Return the meaning of a name, as `NAMES` or a sensor in front of such a name have it: "gps_vn"; "" if unknown.

    Behind a sensor, a single letter has no meaning, since the axes of a sensor are often called x and y.
    """
    sensor, _, rest = plain.partition("_")
    behind = _MEANING.get(rest, "") if len(rest) > 1 else ""
    return _MEANING.get(plain, "") or (behind if behind in _OF_SENSOR.get(sensor, ()) else "")


def read_nested_name(column: str, unit: str = "") -> Name | None:
    """Parse the name of a field of a nested struct, as "gnss.lat": its meaning is that of the last name.

    Parameters
    ----------
    column
        Names of the structs and of the field, separated by dots.
    unit
        Text behind the name, as " [deg]", if the source has the unit.

    Returns
    -------
    Name or None
        The parts of the name. The words are also those of the structs. None without a struct or a meaning, and for
        structs of thrusters, set-points, errors, wind or current, whose fields are not measured motions of the boat.
    """
    struct, _, field = column.rpartition(".")
    name, around = read_name(field + unit), read_name(struct).words
    if not struct or not name.meaning or around & (_OF_OTHERS | DRIVES) or SETPOINT.search(struct):
        return None
    if name.plain in _LETTER_OF and not around & _LETTER_OF[name.plain]:
        return None
    return name._replace(words=name.words | around)


def message_candidates(table: Table) -> list[Candidate]:
    """Return the signals in a table of messages of a known type (ROS, PX4, seatrial), as candidates for a guessed map.

    Parameters
    ----------
    table
        Rows of one topic; `kind` is the type of its messages.

    Returns
    -------
    list of Candidate
        Candidates whose columns are all in the table and have values; empty for an unknown type. All candidates of a
        type have its caveat. Candidates of a topic of set-points or of a simulator's ground truth get a rank with which
        they are not chosen. Parts of an Imu that are marked as not measured (`unmeasured_parts`) are left out if their
        values are constant, and have a caveat if they change.
    """
    kind = table.kind.rpartition("/")[2]
    if table.kind.startswith("px4_msgs/"):
        kind = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind).lower()
    rows = KNOWN.get(kind, ())
    if kind in ("TwistStamped", "Twist", "TwistWithCovarianceStamped"):
        rows = _twist_rows(table, {"Twist": "", "TwistStamped": "twist."}.get(kind, "twist.twist."))
    if kind == "vehicle_odometry" and np.all(table.columns.get("velocity_frame", np.zeros(1)) == BODY_FRD):
        rows = (*rows[:-1], _vector_row("body", "u v", "velocity[0] velocity[1]", "m/s", 2))
    if kind == "TransformStamped" and not _is_pose(table):
        rows = ()
    if kind == "Vector3Stamped" and re.search("(?i)vel", table.topic):
        rows = (_vector_row("velocity", "vx vy", "vector.x vector.y", "m/s", 0),)
    found, unmeasured = [], unmeasured_parts(table)
    for group, rank, signals in rows:
        part = signals[0].columns[0].partition(".")[0]
        if not unmeasured.get(part, True):
            continue
        known = [np.isfinite(table.columns[c]).any() for s in signals for c in s.columns if c in table.columns]
        if len(known) == sum(len(s.columns) for s in signals) and all(known):
            behind = UNCHOSEN_RANK if SETPOINT.search(table.topic) else 0
            caveat = CAVEATS.get(kind, "")
            if part in unmeasured:
                caveat = f"its covariance begins with -1 (not measured), but the values of {part} change"
            found.append(Candidate(group, rank + behind, table, signals, caveat))
    return found


def _is_pose(table: Table) -> bool:
    """Return whether a table of transforms (ROS /tf) has the poses of a vehicle.

    This is so if they are from a frame of the earth (map, odom, world, earth, utm) to a frame that is none of these.
    """
    return table.frame_id.strip("/") in _EARTH_FRAMES and table.topic.rpartition(":")[2] not in _EARTH_FRAMES


def _twist_rows(table: Table, prefix: str) -> tuple[Row, ...]:
    """Return entries (group, rank, signals) like those of the table of known messages, for ROS messages with a twist.

    The message fields begin with `prefix`. If the topic or the frame of `table` belongs to the earth, the entries are
    velocities over ground (vx, vy); otherwise velocities and yaw rate in body axes (u, v, r).
    """
    linear = f"{prefix}linear.x {prefix}linear.y"
    if _EARTH.search(table.topic) or table.frame_id.strip("/") in _EARTH_FRAMES:
        return (_vector_row("velocity", "vx vy", linear, "m/s", 0),)
    return (
        _vector_row("body", "u v", linear, "m/s", 1),
        _vector_row("rate", "r", f"{prefix}angular.z", "rad/s", 1),
    )


def named_commands(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates in which commands have names of their own if the source also has the shaft speeds.

    `drive` and `message_candidates` call commands and shaft speeds n_left and n_right. If the source has both of both
    sides, commands become n_cmd_left and n_cmd_right, in the group "command", so that a map can have all four.

    Parameters
    ----------
    candidates
        All candidates of a source.

    Notes
    -----
    A shaft speed has the hold "linear" and no word of a command in its name. So has a quantity that is only called "n",
    beside other commands; it gets this hold. Set-points of a shaft speed are no commands here. Nor are the outputs of
    an autopilot beside the speeds that its controllers report: these have a delay, and mostly no sign.
    """
    drives = [c for c in candidates if c.group == "drive" and c.rank < UNCHOSEN_RANK and not c.quantity & SET_POINTS]
    drives = [c for c in drives if c.table.kind not in ("Servo", "Esc")]
    lone = {"n"}
    shafts = [c for c in drives if not c.quantity & _COMMANDS and (c.quantity == lone or _is_linear(c))]
    commands = [c for c in drives if not any(c is shaft for shaft in shafts)]
    if not (_has_both_sides(shafts) and _has_both_sides(commands)):
        return list(candidates)
    found = []
    for c in candidates:
        if any(c is command for command in commands):
            signals = tuple(s._replace(name=s.name.replace("n_", "n_cmd_", 1)) for s in c.signals)
            c = c._replace(group="command", signals=signals)
        elif any(c is shaft for shaft in shafts) and not any("hold = " in s.extra for s in c.signals):
            signals = tuple(s._replace(extra=f'{s.extra}, hold = "linear"') for s in c.signals)
            text = 'assumed to be a measured shaft speed, beside the commands; if it is a command, give hold = "zero"'
            c = c._replace(signals=signals, caveat="; ".join(part for part in (c.caveat, text) if part))
        found.append(c)
    return found


def _is_linear(candidate: Candidate) -> bool:
    """Return whether all signals of a candidate have the hold "linear"."""
    return all('hold = "linear"' in signal.extra for signal in candidate.signals)


def _has_both_sides(candidates: Sequence[Candidate]) -> bool:
    """Return whether candidates of one quantity have a left and a right thruster."""
    sides: dict[frozenset[str], set[str]] = {}
    for c in candidates:
        sides.setdefault(c.quantity, set()).update(signal.name for signal in c.signals)
    return any({"n_left", "n_right"} <= names for names in sides.values())


def unmeasured_parts(table: Table) -> dict[str, bool]:
    """Return the parts of a ROS Imu that it marks as not measured, by a first covariance of -1 in all messages.

    Parameters
    ----------
    table
        Rows of one topic.

    Returns
    -------
    dict
        By the name of each such part (`orientation`, `angular_velocity`, `linear_acceleration`): whether its values
        change. Some drivers write -1 for an unknown covariance of a part that they measure; then the values change.
        Empty for other messages.
    """
    found = {}
    for part in IMU_PARTS if table.kind.rpartition("/")[2] == "Imu" else ():
        mark = table.columns.get(f"{part}_covariance[0]")
        if mark is None or not mark.size or not np.all(mark == NOT_MEASURED):
            continue
        axes = [table.columns[f"{part}.{axis}"] for axis in "xyzw" if f"{part}.{axis}" in table.columns]
        found[part] = any(bool(np.any(values != values[0])) for values in axes)
    return found


def wrapped_negative(values: Column) -> np.typing.NDArray[np.bool_]:
    """Find negative numbers that were stored as 65536 - n, by a counter of 16 bits without a sign.

    Parameters
    ----------
    values
        Numbers (n,), raw or scaled, without NaN.

    Returns
    -------
    Array (n,)
        True for wrapped numbers. All False if the case is not clear, or if any number is negative.

    Notes
    -----
    Wrapped numbers are far from all others. The values jump from small to wrapped numbers and back, with hardly any
    values between them.
    """
    none = np.zeros(len(values), bool)
    if len(values) < 2 or np.min(values) < 0.0 or (top := float(np.max(values))) <= 1.0:
        return none
    high = values > 0.7 * top
    low = values < 0.3 * top
    jumps = (low[1:] & high[:-1]) | (low[:-1] & high[1:])
    levels = [len(np.unique(values[part])) for part in (low, high)]
    apart = np.max(values[low], initial=0.0) < 0.5 * np.min(values[high], initial=top)
    clear = np.mean(low | high) > 0.99 and np.count_nonzero(jumps) >= FEWEST_JUMPS and min(levels) >= FEWEST_LEVELS
    return high if clear and apart and np.max(values[low]) < 0.3 * top and _is_of_16_bits(values, high) else none


def _is_of_16_bits(values: Column, high: np.typing.NDArray[np.bool_]) -> bool:
    """Return whether the numbers flagged `high` (n,) can be negative numbers that a 16-bit counter stored as 65536 - n.

    Then they differ by at most about three times the largest of the other numbers in `values` (n,).
    """
    top = float(np.max(values[high]))
    return top - float(np.min(values[high])) < 3.0 * float(np.max(values[~high])) + 1e-9


def quantity(words: frozenset[str]) -> frozenset[str]:
    """Return the words of a thruster's name without side and number: {"motor", "rpm"} for left_motor_rpm_1.

    These words are equal for the left and the right column of one quantity.
    """
    return frozenset(word.rstrip("0123456789") for word in words - SIDES) - {""}


def drive_words(words: frozenset[str]) -> frozenset[str]:
    """Return the words of a name that name a command, shaft speed or force of a thruster; none for other quantities.

    The letter u is one only if no word but a whole one of a side is beside it, such as u_port. With the letter r of the
    right side it is the velocity through the water (u_r).
    """
    is_input = quantity(words) == {_INPUT} and len(words & SIDES) == 1 and not words & {"l", "r"}
    return frozenset({_INPUT}) if is_input else words & DRIVES


def resting_pulse(values: Column) -> tuple[float, float] | None:
    """Return the pulse [us] at which an output rests, and the share of its pulses with this value; None if not shown.

    Parameters
    ----------
    values
        Pulses (n,) [us]; NaN without a value. Zeros (no pulse) are ignored.

    Notes
    -----
    It is the most frequent value within 30 us of 1500 us, most of which is the dead band of usual motor controllers,
    so that a boat does not cruise there. At least 10 % of the pulses must have it. It is not clear if the usual rest of
    1500 us is another frequent value, as of an output that was disarmed for a time.
    """
    pulses = values[np.isfinite(values) & (values != 0.0)]
    levels, counts = np.unique(pulses[np.abs(pulses - PULSE_REST) <= REST_WITHIN], return_counts=True)
    if not levels.size:
        return None
    k = int(np.argmax(counts))
    usual = int(counts[levels == PULSE_REST].sum())
    if counts[k] < LEAST_AT_REST * pulses.size or (levels[k] != PULSE_REST and usual > RIVAL_AT_REST * counts[k]):
        return None
    return float(levels[k]), float(counts[k]) / pulses.size


def drive(words: frozenset[str], values: Column, unit: str) -> tuple[str, MapSignal, str] | None:
    """Recognise a column of commands, shaft speeds or forces of a thruster.

    Parameters
    ----------
    words
        Words of the names of column and topic.
    values
        Numbers of the column and of the column of the other side, which gets the same scale; NaN without a value.
    unit
        Unit of the column as in a map; "" if unknown.

    Returns
    -------
    tuple or None
        Group ("force" or "drive"), signal without its columns, and caveat. The signal of a force is f_left, f_right or
        X. That of a command or shaft speed is n, n_left or n_right, converted to -1 .. 1. Its numbers are taken as this
        command itself, as per cent, as pulses (`PULSES`), or else the largest magnitude is 1 (`MapSignal.full`). The
        result is None if the column does not belong to a thruster, has a unit of another quantity (such as W), or has
        no finite value.
    """
    named = drive_words(words)
    if not named or words & _NOT_DRIVES:
        return None
    if named <= _LETTERS and not words & SIDES and quantity(words) - _LETTERS:  # n or f of another quantity
        return None
    good = values[np.isfinite(values)]
    if unit not in _DRIVE_UNITS or not good.size:
        return None
    wraps = wrapped_negative(good)
    side = "_left" if words & _LEFT and not words & _RIGHT else "_right" if words & _RIGHT and not words & _LEFT else ""
    top = float(np.max(np.abs(good[~wraps])))
    forces = words & {"force", "thrust", "f"}
    if unit in _FORCE_UNITS or (not unit and forces and top > 1.0):
        caveat = "" if unit else f"its numbers, up to {top:.3g}, are assumed to be newtons"
        return "force", MapSignal(f"f{side}" if side else "X", (), unit or "N", "", 'role = "input"'), caveat
    speed = bool(unit in _SPEED_UNITS or words & _SPEEDS)
    role, caveat = 'role = "input"', ""
    if speed and not words & _COMMANDS:
        role += ', hold = "linear"'
        caveat = 'assumed to be a measured shaft speed; if it is a command, give hold = "zero"'

    if wraps.any():
        caveat = "; ".join(part for part in (WRAPPED.format(np.max(good)), caveat) if part)

    def found(unit: str, extra: str, *caveats: str, full: float = 0.0) -> tuple[str, MapSignal, str]:
        """Return group "drive", the signal n, n_left or n_right, and its caveats joined to one text.

        `unit` is the unit of the signal, `extra` are further keys of the import map, and `full` is the number that is
        guessed to be full speed.
        """
        return (
            "drive",
            MapSignal(f"n{side}", (), unit, "", extra, full),
            "; ".join(part for part in (*caveats, caveat) if part),
        )

    if unit == "%":
        small = f'its numbers are at most {top:.3g}; if they are fractions, not per cent, give unit = "1"'
        return found("%", role, "" if top > 1.0 else small)
    if top <= 1.0 and unit in ("", "1"):
        small = "a thrust within -1..1 is assumed to be a command; a force in newtons is f_left or f_right with unit N"
        return found("1", role, small if forces and not unit else "")
    pulses = np.min(good[good != 0.0], initial=top) > 700.0 and top < 2300.0 and "rpm" not in words
    if unit == "us" or (not unit and pulses):
        return found("1", PULSES)
    if top <= 100.0 and not unit and not speed:
        return found("%", role, f"its numbers, up to {top:.3g}, are assumed to be per cent")
    return found("1", role, full=top)
