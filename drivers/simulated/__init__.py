"""The other end of the cables: instruments and light, simulated at wire level."""
