"""A simulated Optotune MR-E controller with its mirror."""
