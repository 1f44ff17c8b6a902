"""Photometric stereo as its benchmarks judge it: angles between normals and the true ones."""
