"""A simulated Swabian Time Tagger, at the level of the vendor's Python package."""
