"""What light meets on its way: the geometry of a scene from depth, normals and segments."""
