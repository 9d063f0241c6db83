"""A simulated Helios laser DAC."""
