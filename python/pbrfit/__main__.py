"""`python -m pbrfit`."""

import sys

from pbrfit.cli import main

sys.exit(main())
