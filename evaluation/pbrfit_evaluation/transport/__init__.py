"""Shadows and light from surface to surface, by geometry: what depth is worth to a fit."""
