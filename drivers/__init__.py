"""Devices: galvo mirrors, photon counters, shutters, and the simulated bench behind their cables."""
