"""What a screen and a notebook show."""
