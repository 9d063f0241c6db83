"""One file = one method = one word on the command line."""
