"""Preflight checks of `seatrial check`: rig, mission, actuators and logs."""
