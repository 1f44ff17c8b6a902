"""Fits of pictures whose light comes from lamps."""
