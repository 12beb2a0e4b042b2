"""Scenes of material points, and what they share."""
