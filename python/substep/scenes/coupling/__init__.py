"""Scenes in which simulations of several kinds meet, and what they share."""
