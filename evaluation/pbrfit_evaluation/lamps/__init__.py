"""Rooms under lamps: what lamps as such are worth to a fit, and where it finds them."""
