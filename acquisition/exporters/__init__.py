"""Other people's files, written: one format, one file."""
