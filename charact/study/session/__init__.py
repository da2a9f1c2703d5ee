"""Sessions of several targets of one camera: how often they agree."""
