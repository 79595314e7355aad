"""Python interface: functions with the defaults and the safeguards of the commands, and their results as objects.

The public names are those of the package ``seatrial`` (``import seatrial as st``).
"""
