"""From Scene to Result: options, objective, priors, solvers, normals, tiles, uncertainty."""
