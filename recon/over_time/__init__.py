"""What moves while it is scanned: the light of several frames brought to one moment, before any method sees it."""
