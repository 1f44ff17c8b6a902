"""Everyday pictures: what files, bad pictures and unknown cameras cost beside clean float ones."""
