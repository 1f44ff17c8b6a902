"""The second-order solver: whether it reaches what it is there for, and at what cost."""
