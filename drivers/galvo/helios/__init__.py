"""Helios laser DAC: ILDA galvos by USB."""
