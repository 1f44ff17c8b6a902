"""Table 1 of the paper on scenes whose ground truth is known, and what the paper leaves out."""
