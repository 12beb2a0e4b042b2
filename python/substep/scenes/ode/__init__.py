"""Scenes of ordinary differential equations, and what they share."""
