"""Estimates that are printed in the paper. They are the true values of the simulations."""

from __future__ import annotations

from seatrial.ident.models.published_values import TABLE_2 as TABLE_2
from seatrial.ident.models.published_values import TABLE_5_3DOF

TABLE_3 = {
    "OE": {"m_r": 6.0708, "d_r": 1.4452, "d_rr": 18.4697},
    "PE": {"m_r": 6.6458, "d_r": 2.1412, "d_rr": 17.0322},
}
TABLE_4 = {
    "OE": {"m_u": 39.8539, "d_u": 0.0003, "d_uu": 31.4743},
    "PE": {"m_u": 39.8006, "d_u": 0.0002, "d_uu": 31.5035},
}
TABLE_5 = {
    "3DOF": TABLE_5_3DOF,
    "6DOF K": {
        "m_u": 40.6120,
        "m_v": 46.3097,
        "m_r": 11.5091,
        "d_u": 9.4546,
        "d_v": 83.7277,
        "d_r": 5.7557,
        "d_uu": 29.1166,
        "d_vv": 11.5098,
        "d_rr": 18.3117,
    },
}
UNITS = {
    "a": "1/s",
    "c1": "N",
    "c2": "N",
    "m_u": "kg",
    "m_v": "kg",
    "m_r": "kg m2",
    "d_u": "kg/s",
    "d_v": "kg/s",
    "d_r": "kg m2/s",
    "d_uu": "kg/m",
    "d_vv": "kg/m",
    "d_rr": "kg m2",
}
