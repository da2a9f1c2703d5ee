"""What each effect of an intensified camera can change in a picture at most, and which of them it does not need."""
