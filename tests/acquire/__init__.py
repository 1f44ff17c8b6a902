"""Tests that need PyTorch, diffusers, transformers or openai: `make test-acquire`."""
