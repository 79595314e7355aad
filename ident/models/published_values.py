"""Values of the boat that the thesis prints.

Models, cases of Monte Carlo studies, and tables of the documents use them.

The simulated boat of `seatrial.mocks` has its own copy, because it imports nothing of `seatrial.ident`.
"""

from __future__ import annotations

from collections.abc import Mapping

# Table 1: nominal values of the hull. Masses and the moment of inertia include the added mass.
TABLE_1: Mapping[str, float] = {
    "m_u": 37.0,  # kg
    "m_v": 47.0,  # kg
    "m_r": 9.69,  # kg m2
    "d_u": 0.2,  # kg/s
    "d_v": 50.0,  # kg/s
    "d_r": 4.14,  # kg m2/s
    "d_uu": 25.0,  # kg/m
    "d_vv": 0.01,  # kg/m
    "d_rr": 6.23,  # kg m2
}
# Table 2: thruster identified on the bench. Pole of the shaft speed, odd and even part of the thrust at full speed.
TABLE_2: dict[str, float] = {
    "a": 2.794,  # 1/s
    "c1": 40.05,  # N
    "c2": 1.11,  # N
}
# Table 5, column 3DOF: the identified hull, in the units of Table 1.
TABLE_5_3DOF: dict[str, float] = {
    "m_u": 43.0775,
    "m_v": 49.8655,
    "m_r": 13.5756,
    "d_u": 8.4193,
    "d_v": 81.3337,
    "d_r": 6.4794,
    "d_uu": 27.8441,
    "d_vv": 11.7343,
    "d_rr": 19.9464,
}
ARM = 0.15  # m, section 4: distance of each thruster from the centre line
