"""First light: what a bench has to say before its first scan, from a few points over the laser's whole period."""
