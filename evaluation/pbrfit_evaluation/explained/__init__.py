"""Rooms by Cycles, each explained in several ways: suites `lamps` and `transport`."""
