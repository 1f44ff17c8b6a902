"""What all rooms say of values: types of arrays, checks of arguments, words for them in errors."""
