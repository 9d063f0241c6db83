"""The report, and the pictures of plans and calibrations."""
