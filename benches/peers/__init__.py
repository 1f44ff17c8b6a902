"""Time of our objective beside what could be used instead, on the same data in one run.

Measured is one evaluation: the mean over pixels, pictures and channels of (I − T)², with its
gradient by every unknown, where I is the model of `docs/model.md`. `python -m peers --help` lists
the options; `make bench-peers` sets everything up.
"""
