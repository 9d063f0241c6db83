"""Aiming and watching by hand: one beam, one counter, light for as long as somebody asks for it."""
