"""Sim-to-real gap: simulation of recorded commands, and identification of parameters."""
