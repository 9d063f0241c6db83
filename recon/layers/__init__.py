"""Neural building blocks; no complete method in here."""
