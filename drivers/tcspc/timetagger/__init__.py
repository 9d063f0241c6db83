"""Swabian Instruments Time Tagger, through the vendor's Python package: histograms by its own measurements, or tags."""
