"""Timed comparisons that are not tests: each against a peer, or a promise, in the same run."""
