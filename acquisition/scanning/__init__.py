"""Runs a plan on a bench: the scan engine, its schemes and its alarms."""
