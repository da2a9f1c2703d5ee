"""Point sources of known MTF: scenes, cases and what methods make of them."""
