"""Wrong normals: what they cost, and how much of it refining them wins back."""
