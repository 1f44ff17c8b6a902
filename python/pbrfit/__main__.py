"""`python -m pbrfit`."""

from pbrfit.cli import run

run()
