"""Readers of users' files under damaged files; `python -m fuzz --help` says how to run them."""
