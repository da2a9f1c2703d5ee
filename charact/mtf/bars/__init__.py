"""Bar targets."""
