"""Export to Gazebo and VRX: SDF blocks with inertia, added mass, damping and thrust limits of a boat model.

The axes of Gazebo are forward, port and up; those of a model are forward, starboard and down. Masses and damping on the
diagonal are the same in both. The lateral position of a thruster changes its sign.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from seatrial.daq.errors import SeatrialError, warn
from seatrial.ident.estimation import thrust_scale_of
from seatrial.ident.export.codegen import Content, provenance_lines
from seatrial.ident.export.history import delayed_inputs
from seatrial.ident.models import SIDES

# Parameters of the equations of motion that become elements of a block
MASSES, DAMPING = ("m_u", "m_v", "m_r"), ("d_u", "d_uu", "d_v", "d_vv", "d_r", "d_rr")
GAZEBO_NAMES = ("xU", "xUabsU", "yV", "yVabsV", "nR", "nRabsR")
VRX_NAMES = ("xU", "xUU", "yV", "yVV", "nR", "nRR")
ADDED_MASS_NAMES = ("xDotU", "yDotV", "nDotR")
ARMS, CURVE, CURRENT = ("y_arm", "y_left", "y_right"), ("c1", "c2"), ("V_x", "V_y")
MOTION = ("x", "y", "psi", "u", "v", "r")  # states of Gazebo itself
ROUNDING = 5e-3  # of the fitted sum: a mass that is larger by less is this sum, with rounded digits
LINK = "base_link"


def write_gazebo(content: Content, *, mass: float | None = None, inertia: float | None = None) -> str:
    """Return an SDF model with the blocks of a boat for Gazebo: inertial, Hydrodynamics and Thruster plugins.

    Parameters
    ----------
    content : Content
        Collected content of a horizontal model.
    mass : float
        Mass of the boat without added mass [kg].
    inertia : float
        Moment of inertia about the vertical axis through the centre of mass, without added inertia [kg m2].

    Raises
    ------
    SeatrialError
        If ``mass`` or ``inertia`` is missing, not positive or more than 0.5 % larger than that of the model, if the
        model lacks a mass or a damping, or if the scale of its thrust is unknown.

    Warns
    -----
    SeatrialWarning
        Always, that the inertias in roll and pitch have to be filled in. Also, with their names, if the model has parts
        that the blocks lack; if an added mass is zero; and if the arms of the thrusters are unknown.

    Notes
    -----
    Added mass is in ``<fluid_added_mass>``, as positive numbers; the physics engine integrates it and adds its Coriolis
    forces. Damping of the plugin follows SNAME (1950): a stability derivative that brakes is negative.
    """
    added = _added_masses(content, mass, inertia)
    values = content.model.values
    legacy = ", ".join(f"{n} {_number(-a)}" for n, a in zip(ADDED_MASS_NAMES, added, strict=True))
    plugin = [
        '    <plugin filename="gz-sim-hydrodynamics-system" name="gz::sim::systems::Hydrodynamics">',
        f"      <link_name>{LINK}</link_name>",
        *(f"      <{n}>{_number(-values[d])}</{n}>" for n, d in zip(GAZEBO_NAMES, DAMPING, strict=True)),
        "    </plugin>",
    ]
    remarks = [
        "Added mass is in fluid_added_mass of the link, which needs the physics engine DART. Without it, the plugin",
        f"takes {legacy} (negative), with less accurate and in older versions wrong Coriolis forces.",
        "Damping of the plugin is negative where it brakes (SNAME 1950). Masses and damping are relative to the water:",
        "the plugin adds a current (default_current, or the topic ocean_current).",
    ]
    added_lines = [
        "        <fluid_added_mass>",
        *(f"          <{n}>{_number(a)}</{n}>" for n, a in zip(("xx", "yy", "rr"), added, strict=True)),
        "        </fluid_added_mass>",
    ]
    return _sdf(content, "Gazebo (SDF)", remarks, _inertial(mass, inertia, added_lines), plugin)


def write_vrx(content: Content, *, mass: float | None = None, inertia: float | None = None) -> str:
    """Return an SDF model with the blocks of a boat for VRX: inertial, SimpleHydrodynamics and Thruster plugins.

    Arguments, errors and warnings are those of `write_gazebo`. All coefficients of this plugin are positive.
    """
    added = _added_masses(content, mass, inertia)
    values = content.model.values
    plugin = [
        '    <plugin filename="libSimpleHydrodynamics.so" name="vrx::SimpleHydrodynamics">',
        f"      <link_name>{LINK}</link_name>",
        *(f"      <{n}>{_number(a)}</{n}>" for n, a in zip(ADDED_MASS_NAMES, added, strict=True)),
        *(f"      <{n}>{_number(values[d])}</{n}>" for n, d in zip(VRX_NAMES, DAMPING, strict=True)),
        "    </plugin>",
    ]
    remarks = [
        "All coefficients of this plugin are positive. It does not apply the Coriolis forces of the added mass: the",
        "Munk moment (m_u - m_v) u v is missing, and the boat turns differently from the model. It knows no current.",
        "Heave, roll and pitch (zDotW, kDotP, mDotQ, zW, kP, mQ) are not part of the model: set them, or the defaults",
        "hold. The plugin of VRX classic (libusv_gazebo_dynamics_plugin.so) has the same names and signs; its thrust",
        "plugin has maxForceFwd and maxForceRev in place of max_thrust_cmd and min_thrust_cmd.",
    ]
    return _sdf(content, "VRX (SDF)", remarks, _inertial(mass, inertia, []), plugin)


def _added_masses(content: Content, mass: float | None, inertia: float | None) -> tuple[float, float, float]:
    """Return the added masses in surge and sway [kg] and the added inertia in yaw [kg m2], after all checks."""
    values = content.model.values
    if missing := [n for n in (*MASSES, *DAMPING) if n not in values]:
        raise SeatrialError(
            f"the model {content.model.name} has no {', '.join(missing)}, which Gazebo needs; use a horizontal model"
        )
    total = tuple(values[n] for n in MASSES)
    if mass is None or inertia is None:
        absent = " and ".join(n for n, v in (("--mass", mass), ("--inertia", inertia)) if v is None)
        raise SeatrialError(
            f"give {absent}: a fit finds only the sums with added mass (surge {total[0]:.4g} kg, sway {total[1]:.4g} "
            f"kg, yaw {total[2]:.4g} kg m2), and Gazebo needs the boat's own part; weigh the boat"
        )
    for option, own, unit, sums in (("--mass", mass, "kg", total[:2]), ("--inertia", inertia, "kg m2", total[2:])):
        if not 0.0 < own < math.inf:
            raise SeatrialError(f"{option} {own:g}: give a positive number, in {unit}")
        if own > (1.0 + ROUNDING) * min(sums):
            raise SeatrialError(
                f"{option} {own:g} {unit} is more than the fitted sum with added mass, {min(sums):.4g} {unit}, so the "
                f"added mass would be {min(sums) - own:.3g} {unit}; check the value, and the thrust with which the "
                "model was fitted"
            )
    scale = thrust_scale_of(content.saved.model)
    if scale.relative:
        raise SeatrialError(
            "the thrust of the model was not given, so its masses and damping are not in kg and N: fit the boat with "
            "`ident vehicle --thruster FILE` or `--fix c1=VALUE`"
        )
    if scale.relative_yaw:
        warn(
            "the arms of the thrusters were not given, so inertia and damping in yaw are right only for the arms in "
            "the file; fit the boat with a rig file that has them"
        )
    added = {"surge": total[0] - mass, "sway": total[1] - mass, "yaw": total[2] - inertia}
    if none := [axis for axis, value in added.items() if value <= 0.0]:
        warn(
            f"the added mass in {' and '.join(none)} is zero, because the value given is the fitted sum of mass and "
            "added mass; a boat alone weighs less: weigh it"
        )
    return max(added["surge"], 0.0), max(added["sway"], 0.0), max(added["yaw"], 0.0)


def _inertial(mass: float | None, inertia: float | None, added: Sequence[str]) -> list[str]:
    """Return the lines of the element ``inertial``, with the lines ``added`` of the added mass.

    Warn that the inertias in roll and pitch are placeholders.

    Notes
    -----
    A missing ixx or iyy is 1 in SDF, and a link with ixx + iyy < izz is refused as impossible. The placeholder izz is
    possible for every izz, and right for the pitch of a slender boat.
    """
    warn(
        "the inertias in roll and pitch (ixx, iyy) are not in a model of the horizontal motion and equal izz in the "
        "file: fill in those of your boat before you simulate roll and pitch"
    )
    izz = _number(inertia or 0.0)
    return [
        "      <inertial>",
        f"        <mass>{_number(mass or 0.0)}</mass>",
        "        <inertia>",
        "          <!-- FILL IN ixx (roll) and iyy (pitch) [kg m2]: the model has no roll and pitch, so these are",
        "               placeholders, equal to izz. Gazebo refuses ixx + iyy < izz. -->",
        f"          <ixx>{izz}</ixx>",
        f"          <iyy>{izz}</iyy>",
        f"          <izz>{izz}</izz>",
        "        </inertia>",
        *added,
        "      </inertial>",
    ]


def _sdf(content: Content, target: str, remarks: Sequence[str], inertial: Sequence[str], plugin: Sequence[str]) -> str:
    """Return the text of an SDF model with a comment at the top. Warn of the parts of the model that it lacks."""
    omitted = _omitted(content)
    if omitted:
        warn(f"the blocks for {target.split()[0]} cannot have these parts of the model: {', '.join(omitted)}")
    omitted += ["current"] if CURRENT[0] in content.model.values else []
    lines = [
        *provenance_lines(content, target),
        "",
        *remarks,
        *content.remarks,
        "",
        f"Not in these blocks: {', '.join(omitted) or 'nothing of the model'}.",
        "Merge them into the model of your boat, with its own link and joint names. The origin of the link is the",
        "centre of mass. Axes: forward, port, up.",
    ]
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            "<!--",
            *(line.replace("--", "- -") for line in lines),
            "-->",
            '<sdf version="1.11">',
            f'  <model name="{content.name}">',
            f'    <link name="{LINK}">',
            *inertial,
            "    </link>",
            *plugin,
            *_thrusters(content),
            "  </model>",
            "</sdf>",
            "",
        ]
    )


def _omitted(content: Content) -> list[str]:
    """Return names of the parts of a model that the blocks lack: effects, shafts, delays, states, parameters.

    The current, which belongs to a run and not to the boat, is not among them.
    """
    model = content.model
    of_effects = {x.name for e in model.effects for part in (e.states, e.parameters, e.inputs) for x in part}
    states = [s.name for s in model.states if s.name not in {*MOTION, *of_effects}]
    delayed = delayed_inputs(i for i in model.inputs if i.name not in of_effects)
    known = {*MASSES, *DAMPING, *ARMS, *CURRENT, *of_effects, *CURVE, *(f"{c}_{side}" for c in CURVE for side in SIDES)}
    other = [p.name for p in content.exported_parameters if p.name not in known]
    return [
        *content.effects,
        *(f"{'shaft' if n.startswith('n_') else 'state'} {n}" for n in (*states, *content.removed_states)),
        *(f"delay of {n}" for n in delayed),
        *([f"parameters {' '.join(other)}"] if other else []),
    ]


def _thrusters(content: Content) -> list[str]:
    """Return the lines of the Thruster plugin of each thruster; a comment if the model has no thrust curve."""
    values = content.model.values
    lines: list[str] = []
    for side in SIDES:
        c1, c2 = (values.get(f"{c}_{side}", values.get(c)) for c in ("c1", "c2"))
        arm = values.get(f"y_{side}", values.get("y_arm", 0.0) * (-1.0 if side == "left" else 1.0))
        if c1 is None or c2 is None:
            return ["    <!-- The model has no thrust curve: set the Thruster plugins from your bench test -->"]
        lines += [
            f"    <!-- {side}: its joint lies {_number(-arm)} m to port of the centre of mass. The shaft speed n,",
            f"         -1 to 1, gives the command {_number(c1)} n|n| + {_number(c2)} n^2 [N]. -->",
            '    <plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">',
            f"      <namespace>{content.name}</namespace>",
            f"      <joint_name>{side}_propeller_joint</joint_name>",
            f"      <max_thrust_cmd>{_number(c1 + c2)}</max_thrust_cmd>",
            f"      <min_thrust_cmd>{_number(c2 - c1)}</min_thrust_cmd>",
            "    </plugin>",
        ]
    return lines


def _number(value: float) -> str:
    """Return a number with ten significant digits; minus zero becomes zero."""
    return f"{value + 0.0:.10g}"
