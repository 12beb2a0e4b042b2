"""Scenes of springs and soft bodies, and what they share."""
