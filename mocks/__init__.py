"""Simulated boat and simulated bench, whose emulated devices are served at real ports."""
