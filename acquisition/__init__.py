"""Scan plans, the scan engine, recordings, and other sources of the same samples."""
