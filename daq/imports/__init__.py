"""Foreign logs -> MCAP: every column becomes a signal with a unit, a hold and a role."""
