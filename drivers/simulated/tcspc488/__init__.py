"""A simulated `tcspc488`, at the level of its messages."""
