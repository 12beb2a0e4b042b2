"""Scenes of position-based dynamics, and what they share."""
