"""Table 1 of the paper on scenes whose truth is known, and what the paper leaves out of it."""
