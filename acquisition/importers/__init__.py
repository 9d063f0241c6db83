"""Other people's files, read: one format, one file."""
