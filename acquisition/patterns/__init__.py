"""Where to look: one scan pattern, one file."""
