"""Result: what a fit hands over, as data and as a folder; errors, previews, relighting."""
