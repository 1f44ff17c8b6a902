"""Pictures that a fit has not seen: how well it explains them, beside other ways."""
