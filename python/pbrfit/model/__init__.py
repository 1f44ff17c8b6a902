"""The forward model: materials, normals and light to radiance, for either reflection model."""
