"""Camera description: sections of parameters, and the capabilities that follow from them."""
