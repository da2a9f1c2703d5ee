"""Serial ports and the request-reply lines on them."""
