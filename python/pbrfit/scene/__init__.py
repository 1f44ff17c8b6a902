"""Scene: the pictures of one view with what is known of it, as arrays and as a folder."""
