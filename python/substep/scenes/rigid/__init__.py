"""Scenes of rigid bodies, and what they share."""
