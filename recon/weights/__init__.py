"""Trained weights, and what reads them."""
