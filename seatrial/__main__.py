"""Run the command tree: `python -m seatrial`."""

from seatrial.command_line import main

main()
