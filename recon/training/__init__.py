"""Scenes, rendering, detector model, losses and the training loop."""
