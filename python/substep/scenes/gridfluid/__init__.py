"""Scenes of liquids on a grid."""
