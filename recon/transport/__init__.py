"""Differentiable light transport: one operator, one file, each with its adjoint."""
