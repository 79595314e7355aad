"""Excite: plans and missions to thrusters, safely, while daq records."""
