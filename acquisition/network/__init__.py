"""Samples to another machine: a server beside the recording, a client that mirrors it elsewhere."""
