"""docs/results.md: every method measured on the same scenes, and what each target has come to."""
