"""The noise of flats, whose spectrum is the transfer behind the gain."""
