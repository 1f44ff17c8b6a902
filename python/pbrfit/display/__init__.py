"""What a screen shows of radiance, and files of it."""
