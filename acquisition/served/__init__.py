"""Samples to another machine: a server beside the recording, a client that keeps a copy of it elsewhere."""
