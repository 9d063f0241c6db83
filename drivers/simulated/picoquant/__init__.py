"""A stand-in for PicoQuant's libraries with a simulated instrument behind it."""
