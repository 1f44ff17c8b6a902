"""Tests of the networks: offline, on the processor, with tiny ones that are made on the spot."""

from __future__ import annotations

import os

# Read when the libraries are imported, so before any test is.
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"
