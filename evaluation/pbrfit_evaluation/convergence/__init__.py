"""Error against run time: solvers, starts and peers on scenes of several sizes and difficulties."""
