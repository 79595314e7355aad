"""Excitation of a craft: bench plans and missions are generated, checked and run while `seatrial.daq` records."""
