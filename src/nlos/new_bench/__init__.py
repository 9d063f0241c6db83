"""A bench file by questions and detection, written with a comment to every line that is not its own."""
