"""The examination of a bench: what `nlos doctor` looks at, in which order, and what it says."""
