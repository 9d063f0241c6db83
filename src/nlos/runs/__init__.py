"""Finding runs again: an index of a folder of recordings, rebuilt from the files whenever asked."""
