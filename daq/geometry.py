"""Geodesy and rotations: the WGS 84 ellipsoid, local coordinates north and east, quaternions and Euler angles.

The body axes are forward, starboard, down (FRD). The local frame is north, east, down (NED).
`seatrial.ident.numerics.rotations` has the rotations of models, which take symbols too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# WGS 84 (NIMA TR8350.2, tables 3.1 and 3.3); the first eccentricity squared with the digits of the table.
WGS84_SEMI_MAJOR_AXIS = 6378137.0  # m
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ECCENTRICITY_2 = 6.69437999014e-3


def local_ned(lat: NDArray[np.float64], lon: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert latitudes and longitudes to metres north and east of the first point.

    Parameters
    ----------
    lat, lon
        Latitude and longitude (n,) [deg], at least one point.

    Returns
    -------
    north, east : Array (n,)
        Distances from the first point [m]. A latitude of NaN gives NaN north, and a longitude of NaN gives NaN east. If
        it is the latitude of the first point, all are NaN; if it is the longitude of the first point, all of `east`.

    Notes
    -----
    The radii of curvature of the WGS 84 ellipsoid at the first point are used (Groves 2013, 2.4.2). The shorter way
    around the globe is taken, so that a track may cross the date line.
    """
    phi = np.radians(lat[0])
    w = 1 - WGS84_ECCENTRICITY_2 * np.sin(phi) ** 2
    meridian = WGS84_SEMI_MAJOR_AXIS * (1 - WGS84_ECCENTRICITY_2) / w**1.5
    normal = WGS84_SEMI_MAJOR_AXIS / np.sqrt(w)
    east = np.radians(np.mod(lon - lon[0] + 180, 360) - 180)
    return meridian * np.radians(lat - lat[0]), normal * np.cos(phi) * east


def from_local_ned(
    north: NDArray[np.float64], east: NDArray[np.float64], origin: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert metres north and east of an origin (latitude, longitude) [deg] to latitudes and longitudes (n,) [deg].

    It is the inverse of `local_ned` with the origin as the first point. Longitudes are from -180 to below 180.
    """
    one_degree = np.array([origin[0], origin[0] + 1.0]), np.array([origin[1], origin[1] + 1.0])
    (_, north_m), (_, east_m) = local_ned(*one_degree)
    return origin[0] + north / north_m, np.mod(origin[1] + east / east_m + 180.0, 360.0) - 180.0


def geodetic(x: float, y: float, z: float) -> tuple[float, float]:
    """Convert a point in ECEF [m] to latitude and longitude [deg] of WGS 84 (Bowring 1976).

    Both are NaN for a point less than 1 m from the axis of the earth, such as (0, 0, 0) of a receiver without a fix.
    """
    a, f = WGS84_SEMI_MAJOR_AXIS, WGS84_FLATTENING
    b, e2 = a * (1.0 - f), f * (2.0 - f)
    p = math.hypot(x, y)
    if p < 1.0:
        return math.nan, math.nan
    theta = math.atan2(z * a, p * b)
    lat = math.atan2(z + e2 / (1.0 - e2) * b * math.sin(theta) ** 3, p - e2 * a * math.cos(theta) ** 3)
    return math.degrees(lat), math.degrees(math.atan2(y, x))


def ecef_to_ned(x: float, y: float, z: float, lat: float, lon: float) -> tuple[float, float, float]:
    """Rotate a vector (x, y, z) from ECEF to NED at a latitude and longitude [deg] (Farrell 2008, eq. 2.24).

    The result (north, east, down) has the unit of the vector. It is NaN if the longitude is NaN. If only the latitude
    is NaN, north and down are NaN.
    """
    phi, lam = math.radians(lat), math.radians(lon)
    outward = math.cos(lam) * x + math.sin(lam) * y
    north = math.cos(phi) * z - math.sin(phi) * outward
    return north, math.cos(lam) * y - math.sin(lam) * x, -math.cos(phi) * outward - math.sin(phi) * z


def quaternion(yaw: float, pitch: float, roll: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of the rotation from the body frame (FRD) to NED.

    The angles [rad] are Euler angles in the order ZYX. Source: Diebel 2006, eq. 290.
    """
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def rotation_matrix(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Return the rotation matrix from the body frame (FRD) to NED, shape (3, 3) (Fossen 2011, eq. 2.18).

    The angles are Euler angles [rad] in the order ZYX.
    """
    x, y, z, w = quaternion(yaw, pitch, roll)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def euler_angles(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], w: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the Euler angles yaw, pitch and roll [rad] of unit quaternions (x, y, z, w), each shape (n,).

    Yaw and roll are within -pi..pi, and pitch is within -pi/2..pi/2. A quaternion with NaN has the angles NaN.
    """
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return yaw, pitch, roll


def scalar_euler_angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Return the Euler angles yaw, pitch and roll [rad] of one unit quaternion, as `euler_angles` does for arrays.

    Decoders call this function for each sample, for which `euler_angles` would be slow.
    """
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return yaw, pitch, roll
