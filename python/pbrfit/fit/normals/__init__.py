"""Normals that are refined together with materials and lights."""
