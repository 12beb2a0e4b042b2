"""Scenes of position-based fluids, and what they share."""
