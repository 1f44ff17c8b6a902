"""Normals, materials and lamps from pictures of one view, each under a lamp of its own."""
