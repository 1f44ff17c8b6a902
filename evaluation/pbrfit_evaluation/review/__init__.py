"""How often the review of generated pictures finds damage, and refuses honest pictures."""
