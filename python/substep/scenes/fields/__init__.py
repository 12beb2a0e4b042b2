"""Scenes of particles in velocity fields, and what they share."""
