"""What one stack of dark or evenly lit frames tells."""
