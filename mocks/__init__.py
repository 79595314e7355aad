"""Pretend: a simulated boat and a simulated bench behind real ports."""
